"""The HTML page and the picture files."""

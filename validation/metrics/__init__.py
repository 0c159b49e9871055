"""Image and volume metrics, each with its standard error."""

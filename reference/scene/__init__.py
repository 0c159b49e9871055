"""Scene loaders: every supported file format becomes one `Scene`."""

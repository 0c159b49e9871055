"""OpenCL: per-pixel sampling of the virtual texture."""

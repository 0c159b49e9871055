"""The 3D virtual texture: tiles, indirection, and the NumPy sampler that specifies the kernel."""

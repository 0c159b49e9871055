"""Reference implementation: light transport, placement and virtual texturing, slow and obvious where it can be."""

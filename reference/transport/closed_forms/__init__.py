"""Form factors of planar polygons without rays, the proof that nothing is in the way, and single pairs of meshes."""

"""Voxel bitmap, octree, validity of probes."""

"""Scene files in, one validated `Scene` out."""

from .document import Document, MeshArrays
from .load import load_scene, read_document

__all__ = ["Document", "MeshArrays", "load_scene", "read_document"]

"""`run --fly`: a viewer is moved through a scene whose tiles are streamed within a budget, and every frame is measured."""

"""The failure catalogue as cases: each provoked, measured, judged, and followed to the point where it breaks."""

"""Ground truth: path tracing with Mitsuba, and closed forms."""

"""Light leaks through walls: predicted from geometry, attributed to probes, stopped by the smallest bitmap edit."""

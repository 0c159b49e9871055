"""`lightgauge bench`: speed and memory as ratios to peers and to what the machine can do, measured side by side in one run."""

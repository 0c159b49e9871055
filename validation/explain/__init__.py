"""One pixel, explained: which probes light it, by how much, through which walls, and what is wrong with each stage there."""

"""Seeded faults in the product's own code, applied in memory, and whether the gates notice them."""

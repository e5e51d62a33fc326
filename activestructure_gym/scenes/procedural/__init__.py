"""Generate apartments from a seed: floor plans, rooms, furniture and baked light."""

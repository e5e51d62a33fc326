"""Generate apartments: plans, rooms, furniture, light."""

"""Generated apartments: plans, rooms, furniture, light."""

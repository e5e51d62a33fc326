"""Load scenes from files: meshes, published datasets, datasets configured for Habitat, posed sequences."""

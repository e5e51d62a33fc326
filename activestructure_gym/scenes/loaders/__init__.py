"""Scenes from files: meshes, Replica, Matterport3D, posed sequences."""

"""Scenes from files: meshes, Replica, Matterport3D, ScanNet, ScanNet++, posed sequences."""

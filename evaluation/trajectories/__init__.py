"""Trajectories from outside: files of poses, whose axes they mean, and whether a camera can have been there."""

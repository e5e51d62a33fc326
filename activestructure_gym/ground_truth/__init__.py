"""What is true of a scene and no planner may know: free space, start poses, the observable surface."""

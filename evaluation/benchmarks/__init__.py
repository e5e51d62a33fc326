"""What `asg bench` measures on this machine, one file per part."""

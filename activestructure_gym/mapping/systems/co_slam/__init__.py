"""Co-SLAM on given poses."""

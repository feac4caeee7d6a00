"""ROS 2 nodes: one thin file each around an algorithm that knows no ROS."""

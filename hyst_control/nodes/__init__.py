"""ROS 2 nodes, each a thin file around an algorithm without ROS."""

"""Starting of nodes as processes on a ROS domain of their own, without importing ROS."""

"""Starting nodes as processes on a ROS domain of their own; imports no ROS itself."""

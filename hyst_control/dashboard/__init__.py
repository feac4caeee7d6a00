"""A live page of a running loop: what a browser shows of it, without ROS."""

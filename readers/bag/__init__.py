"""Recordings of message streams: ROS 1 bags, ROS 2 bags, MCAP."""

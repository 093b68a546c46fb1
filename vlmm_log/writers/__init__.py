"""Logs written in other containers: ROS 1 bags, ROS 2 folders, MCAP and TUM folders."""

"""ROS messages and MCAP files of them: what both converted logs and recordings are written with."""

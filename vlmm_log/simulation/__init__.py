"""Rooms that are known exactly, and what a Kinect-like camera sees of them."""

"""Many logs: tasks and what came of them, the folder that holds it, and the engines that run them."""

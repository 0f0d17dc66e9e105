"""ROS bags: drives of the twin go out as one, drives of a real robot come in as interventions."""

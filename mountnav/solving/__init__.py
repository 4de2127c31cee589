"""From a frame to its solution: read, measure, identify, judge."""

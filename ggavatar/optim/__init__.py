"""What is optimized and how: row-aligned parameters, schedules, seeds, corrections of the tracking."""

"""What is optimised and how: row-aligned parameters, schedules, seeds, corrections of the tracking."""

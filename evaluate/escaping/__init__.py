"""Text in output formats, one file a format: whatever it says, it is shown as it is and cannot become markup."""

"""The head that the project makes itself: no licensed data in it."""

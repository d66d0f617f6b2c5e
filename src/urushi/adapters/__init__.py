"""Where Urushi meets other systems, one in each file: nothing outside this package knows their formats."""

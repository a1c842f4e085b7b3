"""Types that a user names: enumerations."""

"""Types that a user names: enumerations and buses."""

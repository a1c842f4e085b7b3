"""What holds for every member of a region, not only for those that were drawn: enclosures and branch and bound."""

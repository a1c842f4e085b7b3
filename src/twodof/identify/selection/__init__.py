"""Which structure the data ask for: fits ranked and tested against each other, terms of a regression one by one."""

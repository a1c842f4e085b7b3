"""From a flight to a model in one call: which experiment a log holds, what is fitted, whether it is enough."""

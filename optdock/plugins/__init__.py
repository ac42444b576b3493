"""What plugins are: their interfaces, life cycle, parameters, outcomes, and the registry that finds them."""

"""`ManoeuvrePlanner`: manoeuvres from any pose into the dock with as many cusps as needed."""

"""The field world: a drive, sensors and a dock as robots in the field have them, with no code of `optdock.simulation`.

Every trait is a field of a frozen description; set alone, off or stronger, it changes nothing else, because each part
draws from a random stream of its own.
"""

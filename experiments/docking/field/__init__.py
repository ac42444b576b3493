"""Field world: drive, sensors and dock with the imperfections of real robots, without code of `optdock.simulation`.

Every imperfection is a field of a frozen description. Each part draws from a separate random stream, so changing one
field changes nothing else.
"""

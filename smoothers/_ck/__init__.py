"""The parts of `CasadiSmoother`: sequential convex steps on clothoid splines."""

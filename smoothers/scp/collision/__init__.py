"""Clearance of the swept footprint: scene, broad phase, narrow phase, linear constraint rows."""

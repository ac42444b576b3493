"""Behaviors: timed auxiliary motions with a collision check ahead."""

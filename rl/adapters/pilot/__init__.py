"""A policy as the MAVLink companion of real vehicles: telemetry in, set points out."""

"""Algebra that knows no GNSS: least squares, Kalman updates, and (later beside them) integers and quality control."""

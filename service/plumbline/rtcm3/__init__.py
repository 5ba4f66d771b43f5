"""RTCM 10403 both ways, without input or output: bytes → frames → messages, and back."""

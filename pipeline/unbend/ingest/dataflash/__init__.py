"""ArduPilot DataFlash logs, binary (.bin) and text (.log)."""

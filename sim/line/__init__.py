"""What stands between a vehicle and who talks to it: links, wires, files, logs, signing."""

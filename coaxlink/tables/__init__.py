"""A mixing law as an autopilot's table, and what that firmware will make of it. No MAVLink in here."""

TABLE_LAWS = ("fitted", "balanced", "reduced", "standard", "curved")

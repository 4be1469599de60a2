"""Plans flown on a real autopilot through MAVSDK, within limits of our own, and their logs down again."""

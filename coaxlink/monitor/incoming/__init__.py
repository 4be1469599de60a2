"""What comes in, from a link or a recording, and is kept: knows neither the rotors nor the screen."""

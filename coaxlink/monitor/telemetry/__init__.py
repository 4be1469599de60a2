"""What messages say of a vehicle: readings, and whose of them are believed."""

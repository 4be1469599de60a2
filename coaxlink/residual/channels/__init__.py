"""A log as measured and predicted loads with their noise, and the regression made of them."""

"""Models of vessels (usv) and aircraft (uav), and of the contact between them."""

"""What people ask of a night that goes on."""

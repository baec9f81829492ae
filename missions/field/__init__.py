"""What a crew does around a flight: plan, check, calibrate, detect, prepare."""

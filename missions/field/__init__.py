"""What a crew does around a flight: plan, check, tick, calibrate, detect, prepare."""

"""The trial of calibrations from rendered boards."""

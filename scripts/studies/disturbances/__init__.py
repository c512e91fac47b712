"""What every disturbance costs, and what the measure against it gains."""

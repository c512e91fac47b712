"""What a recording says about static friction."""

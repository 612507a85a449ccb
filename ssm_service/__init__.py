"""Speed and separation monitoring for robot arms."""

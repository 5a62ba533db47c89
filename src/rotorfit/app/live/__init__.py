"""Live tracking of a vehicle: the outlets of its states and alarms besides the terminal."""

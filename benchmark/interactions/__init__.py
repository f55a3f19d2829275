"""Reference drivers: would somebody competent have avoided it? UN Regulation 157, RSS, FSM, IDM."""

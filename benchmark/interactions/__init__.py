"""Reference drivers: would a competent driver have avoided it? UN Regulation 157, RSS, FSM, IDM."""

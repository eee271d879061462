"""Places of a DC motor's parameters in MuJoCo's `actuator_gainprm` and `actuator_dynprm`, named as in draws.toml."""

RESISTANCE, TORQUE_CONSTANT, RESISTANCE_PER_K, REFERENCE_C, KP, KD, VOLTAGE_MAX = 0, 1, 2, 3, 4, 6, 7
"""In `gainprm`. REFERENCE_C is the temperature at which the winding has `RESISTANCE`."""
WINDING_TO_HOUSING, WINDING_CAPACITY, AMBIENT_C = 2, 3, 4
"""In `dynprm`."""

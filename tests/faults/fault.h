/* The healthy plant, and when its fault sets in. */
#include "two_mass.c"

#define FAULT_TIME 1.0 /* s */

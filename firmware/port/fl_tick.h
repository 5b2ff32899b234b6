/* The control period of all laws: the one place that tells it. */
#ifndef FL_TICK_H
#define FL_TICK_H

#define FL_TICK_HZ 2000
#define FL_TICK_S (1.0f / FL_TICK_HZ)

#endif

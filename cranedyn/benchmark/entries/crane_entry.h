/* Entry of the benchmark of crane control as a shared library in C; see docs/benchmark.md.

   A library defines crane_begin and crane_command, and may define crane_message:

     cranedyn benchmark header
     cc -O2 -fPIC -shared mine.c -o mine.so
     cranedyn benchmark run mine.so

   It is called by one thread. All pointers are valid until the call returns. Units are SI: positions of
   drives in rad or m, angles in rad, times in s. */
#ifndef CRANE_ENTRY_H
#define CRANE_ENTRY_H

#include <stdint.h>

#ifdef _WIN32
#define CRANE_ENTRY __declspec(dllexport)
#else
#define CRANE_ENTRY __attribute__((visibility("default")))
#endif

/* What is told of an instance, of a crane with m drives and s swing angles. */
typedef struct {
  const char *task;  /* such as "inteco/move" */
  const char *crane; /* "inteco" */
  const char *kind;  /* "move", "path", "wind", "operator", "unknown" or "sensors" */
  int32_t drives;    /* m */
  int32_t swings;    /* s */
  int32_t hoist;     /* index of the drive that is the length of the rope; -1 if none is */
  const char *const *drive_names; /* m names, such as "bridge", "x" and "l" */
  const char *const *swing_names; /* s names, such as "phi" and "theta" */
  double period;       /* from one command to the next */
  double duration;     /* of the instance */
  double gravity;      /* m/s2 */
  double payload_mass; /* kg, as planned for; the load that hangs there may differ */
  double swing_period; /* of the load on the longer of its ropes at start and goal */
  double swing_bound;  /* largest swing allowed */
  double tolerance;    /* distance of the load from its goal up to which it counts as settled, m */
  double delay;        /* of the drives */
  const double *largest_rates;         /* of the m drives; commands beyond are clipped */
  const double *largest_accelerations; /* of the m drives */
  const double *largest_jerks;         /* of the m drives */
  const double *lags;                  /* time constants of the m drives */
  const double *lower;                 /* ends of the ranges of the m drives */
  const double *upper;
  const double *start; /* positions of the m drives */
  const double *goal;  /* positions of the m drives; NULL under an operator, and on a path */
} crane_briefing;

/* What is measured in a control period. */
typedef struct {
  double t;                    /* since the start */
  const double *position;      /* of the m drives */
  const double *rate;          /* of the m drives */
  const double *swing;         /* s angles of the load from where it hangs at rest */
  const double *swing_rate;    /* of the s angles */
  const double *operator_rate; /* that the operator asks for, m numbers; zero without an operator */
  const double *target;        /* where the m drives shall be now: the goal, the point of the path, or
                                  where the operator has sent them */
  const double *target_rate;   /* rates of these m positions */
} crane_reading;

/* Begin an instance. Return 0 if the library takes part, 1 if it declines the task, and any other
   number for a failure. What the library remembers of an instance before is its own to forget. */
CRANE_ENTRY int32_t crane_begin(const crane_briefing *briefing);

/* Write the rates of the m drives for a reading. Return 0, or another number for a failure. */
CRANE_ENTRY int32_t crane_command(const crane_reading *reading, double *rates);

/* Say why the last call declined or failed, or NULL. A library need not define it. */
CRANE_ENTRY const char *crane_message(void);

#endif

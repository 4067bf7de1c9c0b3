/* The interface of FMI 2.0: co-simulation and model exchange, around fmi_unit.h. */

#define FMI(name) fmi2##name
#define DERIVATIVES fmi2GetDerivatives
#define SAVED(before, after) fmi2##before##FMUstate##after
#define DESERIALIZE fmi2DeSerializeFMUstate

#include "fmi_shared.h"

typedef void (*Log)(void *environment, const char *name, Status status, const char *category, const char *message, ...);

typedef struct {
  Log log;
  void *(*allocate)(size_t count, size_t size);
  void (*release)(void *memory);
  void (*finished)(void *environment, Status status);
  void *environment;
} Callbacks;

typedef struct {
  int again, terminate, nominals, values, defined;
  double next;
} EventInfo;

static void write_log(Unit *unit, Status status, const char *message) {
  ((Log)unit->callback)(unit->environment, unit->name, status, "logStatus", "%s", message);
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources, const Callbacks *callbacks, int visible,
                             int logging) {
  (void)resources, (void)visible, (void)logging;
  if (!token || strcmp(token, TOKEN)) {
    if (callbacks && callbacks->log) callbacks->log(callbacks->environment, name, ERROR, "logStatus", "The GUID is not that of this unit.");
    return NULL;
  }
  Unit *unit = type == 0 && !STATES ? NULL : calloc(1, sizeof *unit);
  if (!unit) return NULL;
  unit->environment = callbacks ? callbacks->environment : NULL;
  unit->callback = callbacks ? (void (*)(void))callbacks->log : NULL;
  unit->log = write_log;
  unit->name = "cranedyn";
  begin(&unit->data);
  return unit;
}

EXPORT Status fmi2SetDebugLogging(Unit *unit, int on, size_t n, const char *const *categories) {
  (void)unit, (void)on, (void)n, (void)categories;
  return OK;
}

EXPORT Status fmi2SetupExperiment(Unit *unit, int tolerance_defined, double tolerance, double start, int stop_defined, double stop) {
  (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
  unit->data.time = start;
  return OK;
}

EXPORT Status fmi2EnterInitializationMode(Unit *unit) { return enter_initialization(unit, unit->data.time); }

EXPORT Status fmi2GetReal(Unit *unit, const uint32_t *references, size_t n, double *values) { return get_real(unit, references, n, values); }
EXPORT Status fmi2SetReal(Unit *unit, const uint32_t *references, size_t n, const double *values) {
  return set_real(unit, references, n, values);
}

EXPORT Status fmi2GetBoolean(Unit *unit, const uint32_t *references, size_t n, int *values) {
  Status status = get_valid(unit, references, n);
  for (size_t i = 0; i < n && status == OK; i++) values[i] = unit->data.valid;
  return status;
}

EXPORT Status fmi2SetBoolean(Unit *unit, const uint32_t *references, size_t n) { return n ? unknown(unit, *references) : OK; }

NONE(Integer) NONE(String)

EXPORT Status fmi2DoStep(Unit *unit, double point, double step, int no_restore) { return (void)no_restore, advance(unit, point, step); }

/* Model exchange; there are no events. */
EXPORT Status fmi2NewDiscreteStates(Unit *unit, EventInfo *info) {
  (void)unit;
  memset(info, 0, sizeof *info);
  return OK;
}

EXPORT Status fmi2CompletedIntegratorStep(Unit *unit, int no_restore, int *event, int *terminate) {
  (void)no_restore;
  look(&unit->data);
  unit->data.invalid |= !unit->data.valid;
  *event = *terminate = 0;
  return OK;
}

/* What this unit says it does not have. */
ABSENT(GetDirectionalDerivative) ABSENT(SetRealInputDerivatives) ABSENT(GetRealOutputDerivatives) ABSENT(CancelStep)
ABSENT(GetStatus) ABSENT(GetRealStatus) ABSENT(GetIntegerStatus) ABSENT(GetBooleanStatus) ABSENT(GetStringStatus)

/* The interface of FMI 3.0: co-simulation and model exchange, around fmi_unit.h. */

#define FMI(name) fmi3##name
#define DERIVATIVES fmi3GetContinuousStateDerivatives
#define SAVED(before, after) fmi3##before##FMUState##after
#define DESERIALIZE fmi3DeserializeFMUState

#include "fmi_shared.h"

typedef void (*Log)(void *environment, Status status, const char *category, const char *message);

static void write_log(Unit *unit, Status status, const char *message) {
  ((Log)unit->callback)(unit->environment, status, "logStatus", message);
}

static Unit *instantiate(const char *token, void *environment, Log log) {
  if (!token || strcmp(token, TOKEN)) {
    if (log) log(environment, ERROR, "logStatus", "The instantiation token is not that of this unit.");
    return NULL;
  }
  Unit *unit = calloc(1, sizeof *unit);
  if (!unit) return NULL;
  unit->environment = environment;
  unit->callback = (void (*)(void))log;
  unit->log = write_log;
  begin(&unit->data);
  return unit;
}

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging, bool events,
                                         bool early, const uint32_t *required, size_t n_required, void *environment, Log log, void *update) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)n_required, (void)update;
  return instantiate(token, environment, log);
}

EXPORT void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible, bool logging,
                                          void *environment, Log log) {
  (void)name, (void)resources, (void)visible, (void)logging;
  return STATES ? instantiate(token, environment, log) : NULL;
}

EXPORT void *fmi3InstantiateScheduledExecution(void) { return NULL; }

EXPORT Status fmi3SetDebugLogging(Unit *unit, bool on, size_t n, const char *const *categories) {
  (void)unit, (void)on, (void)n, (void)categories;
  return OK;
}

EXPORT Status fmi3EnterInitializationMode(Unit *unit, bool tolerance_defined, double tolerance, double start, bool stop_defined, double stop) {
  (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
  return enter_initialization(unit, start);
}

static const char MISMATCH[] = "There are not as many values as value references.";

EXPORT Status fmi3GetFloat64(Unit *unit, const uint32_t *references, size_t n, double *values, size_t n_values) {
  return n == n_values ? get_real(unit, references, n, values) : tell(unit, ERROR, "%s", MISMATCH);
}

EXPORT Status fmi3SetFloat64(Unit *unit, const uint32_t *references, size_t n, const double *values, size_t n_values) {
  return n == n_values ? set_real(unit, references, n, values) : tell(unit, ERROR, "%s", MISMATCH);
}

EXPORT Status fmi3GetBoolean(Unit *unit, const uint32_t *references, size_t n, bool *values, size_t n_values) {
  if (n != n_values) return tell(unit, ERROR, "%s", MISMATCH);
  Status status = get_valid(unit, references, n);
  for (size_t i = 0; i < n && status == OK; i++) values[i] = unit->data.valid;
  return status;
}

EXPORT Status fmi3DoStep(Unit *unit, double point, double step, bool no_restore, bool *event, bool *terminate, bool *early, double *last) {
  (void)no_restore;
  *event = *terminate = *early = false;
  *last = unit->data.time;
  Status status = advance(unit, point, step);
  *last = unit->data.time;
  return status;
}

/* Model exchange; there are no events. */
EXPORT Status fmi3UpdateDiscreteStates(Unit *unit, bool *again, bool *terminate, bool *nominals, bool *values, bool *defined, double *next) {
  (void)unit, (void)next;
  *again = *terminate = *nominals = *values = *defined = false;
  return OK;
}

EXPORT Status fmi3CompletedIntegratorStep(Unit *unit, bool no_restore, bool *event, bool *terminate) {
  (void)no_restore;
  look(&unit->data);
  unit->data.invalid |= !unit->data.valid;
  *event = *terminate = false;
  return OK;
}

EXPORT Status fmi3GetNumberOfContinuousStates(Unit *unit, size_t *n) { return (void)unit, *n = STATES, OK; }
EXPORT Status fmi3GetNumberOfEventIndicators(Unit *unit, size_t *n) { return (void)unit, *n = 0, OK; }

NONE(Float32) NONE(Int8) NONE(UInt8) NONE(Int16) NONE(UInt16) NONE(Int32) NONE(UInt32) NONE(Int64) NONE(UInt64) NONE(String)
NONE(Binary) NONE(Clock)

EXPORT Status fmi3SetBoolean(Unit *unit, const uint32_t *references, size_t n) { return n ? unknown(unit, *references) : OK; }

/* What belongs to clocks, configuration and derivatives, none of which this unit says it has. */
ABSENT(GetNumberOfVariableDependencies) ABSENT(GetVariableDependencies) ABSENT(GetDirectionalDerivative)
ABSENT(GetAdjointDerivative) ABSENT(EnterConfigurationMode) ABSENT(ExitConfigurationMode) ABSENT(GetIntervalDecimal)
ABSENT(GetIntervalFraction) ABSENT(GetShiftDecimal) ABSENT(GetShiftFraction) ABSENT(SetIntervalDecimal) ABSENT(SetIntervalFraction)
ABSENT(SetShiftDecimal) ABSENT(SetShiftFraction) ABSENT(EvaluateDiscreteStates) ABSENT(EnterStepMode) ABSENT(GetOutputDerivatives)
ABSENT(ActivateModelPartition)

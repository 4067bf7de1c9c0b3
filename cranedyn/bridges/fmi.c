/* A crane as a co-simulation unit of FMI 3.0: what the standard asks for, around the compiled loop `run`.

   unit.h, written for each crane, says what stands where in the memory of the loop:
   TOKEN, DT, SLOT_*, SIZE_*, AT_* and the tables of variables. */

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "unit.h"

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef void (*Log)(void *environment, Status status, const char *category, const char *message);
typedef enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED } Mode;

void run(int64_t *call);

/* All that changes: what is saved, restored and sent elsewhere as it is. */
typedef struct {
  double value[VARIABLES];
  double state[SIZE_STATE], log[SIZE_ROW], summary[SIZE_SUMMARY];
  double gain_table[SIZE_GAIN_TABLE], setpoint_table[SIZE_SETPOINT_TABLE];
  double time;
  int32_t mode, stale, invalid, reserved;
} Data;

typedef struct {
  Data data;
  void *environment;
  Log log;
} Unit;

static Status tell(Unit *unit, Status status, const char *message) {
  if (unit->log) unit->log(unit->environment, status, "logStatus", message);
  return status;
}

static void begin(Data *data) {
  memset(data, 0, sizeof *data);
  for (int i = 0; i < VARIABLES; i++) data->value[i] = VARIABLE[i].start;
  data->stale = 1;
}

/* The loop for one control instant: row of the log, then so many physics steps, or none. */
static void loop(Data *data, int64_t steps) {
  int64_t call[SLOTS] = {0};
  double dt = DT, period = steps ? steps * DT : DT;
  memcpy(data->gain_table + AT_FEED_FORWARD, data->value + COMMAND, DRIVES * sizeof(double));
  for (int i = 0; i < DRIVES; i++) data->gain_table[AT_LIMIT + i] = INFINITY;
  data->summary[AT_INVALID] = INFINITY;
  call[SLOT_STATE] = (int64_t)(intptr_t)data->state;
  call[SLOT_GAIN_TABLE] = (int64_t)(intptr_t)data->gain_table;
  call[SLOT_SETPOINT_TABLE] = (int64_t)(intptr_t)data->setpoint_table;
  call[SLOT_FORCE] = (int64_t)(intptr_t)(data->value + FORCE);
  call[SLOT_LOG] = (int64_t)(intptr_t)data->log;
  call[SLOT_SUMMARY] = (int64_t)(intptr_t)data->summary;
  call[SLOT_GAIN_TABLE_ROWS] = call[SLOT_SETPOINT_TABLE_ROWS] = call[SLOT_FORCE_ROWS] = 1;
  call[SLOT_LAST] = call[SLOT_LOG_INTERVAL] = call[SLOT_SUBSTEPS] = 1;
  call[SLOT_END] = steps ? 1 : 0;
  call[SLOT_STEPS] = steps;
  memcpy(call + SLOT_DT, &dt, sizeof dt);
  memcpy(call + SLOT_PERIOD, &period, sizeof period);
  run(call);
}

/* Outputs at the present state under the present inputs. */
static void look(Data *data) {
  if (!data->stale) return;
  if (data->mode <= INITIALIZING) {
    memset(data->state, 0, sizeof data->state);
    memcpy(data->state, data->value + START, STATES * sizeof(double));
  }
  double before[SIZE_STATE];
  memcpy(before, data->state, sizeof before);
  loop(data, 0);
  memcpy(data->state, before, sizeof before);
  memcpy(data->value + OUTPUT, data->state, STATES * sizeof(double));
  memcpy(data->value + OUTPUT + STATES, data->log + AT_EFFORT, DRIVES * sizeof(double));
  data->value[OUTPUT + STATES + DRIVES] = data->log[AT_ENERGY];
  data->value[VALID] = !data->invalid && isinf(data->summary[AT_INVALID]);
  data->stale = 0;
}

const char *fmi3GetVersion(void) { return "3.0"; }

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging, bool events,
                                  bool early, const uint32_t *required, size_t n_required, void *environment, Log log, void *update) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)n_required, (void)update;
  if (!token || strcmp(token, TOKEN)) {
    if (log) log(environment, ERROR, "logStatus", "The instantiation token is not that of this unit.");
    return NULL;
  }
  Unit *unit = calloc(1, sizeof *unit);
  if (!unit) return NULL;
  unit->environment = environment;
  unit->log = log;
  begin(&unit->data);
  return unit;
}

void *fmi3InstantiateModelExchange() { return NULL; }
void *fmi3InstantiateScheduledExecution() { return NULL; }
void fmi3FreeInstance(Unit *unit) { free(unit); }
Status fmi3SetDebugLogging() { return OK; }

Status fmi3EnterInitializationMode(Unit *unit, bool tolerance_defined, double tolerance, double start, bool stop_defined, double stop) {
  (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
  if (unit->data.mode != INSTANTIATED) return tell(unit, ERROR, "Initialization has begun before; reset first.");
  unit->data.mode = INITIALIZING;
  unit->data.time = unit->data.value[0] = start;
  unit->data.stale = 1;
  return OK;
}

Status fmi3ExitInitializationMode(Unit *unit) {
  if (unit->data.mode != INITIALIZING) return tell(unit, ERROR, "Initialization has not begun.");
  unit->data.stale = 1;
  look(&unit->data);
  unit->data.mode = STEPPING;
  return OK;
}

Status fmi3Terminate(Unit *unit) {
  unit->data.mode = TERMINATED;
  return OK;
}

Status fmi3Reset(Unit *unit) {
  begin(&unit->data);
  return OK;
}

static Status unknown(Unit *unit, uint32_t reference) {
  char text[120];
  snprintf(text, sizeof text, "There is no such variable with value reference %u.", (unsigned)reference);
  return tell(unit, ERROR, text);
}

Status fmi3GetFloat64(Unit *unit, const uint32_t *references, size_t n, double *values, size_t n_values) {
  if (n != n_values) return tell(unit, ERROR, "There are not as many values as value references.");
  look(&unit->data);
  for (size_t i = 0; i < n; i++) {
    if (references[i] >= VALID) return unknown(unit, references[i]);
    values[i] = unit->data.value[references[i]];
  }
  return OK;
}

Status fmi3GetBoolean(Unit *unit, const uint32_t *references, size_t n, bool *values, size_t n_values) {
  if (n != n_values) return tell(unit, ERROR, "There are not as many values as value references.");
  look(&unit->data);
  for (size_t i = 0; i < n; i++) {
    if (references[i] != VALID) return unknown(unit, references[i]);
    values[i] = unit->data.value[VALID] != 0.0;
  }
  return OK;
}

Status fmi3SetFloat64(Unit *unit, const uint32_t *references, size_t n, const double *values, size_t n_values) {
  char text[200];
  if (n != n_values) return tell(unit, ERROR, "There are not as many values as value references.");
  for (size_t i = 0; i < n; i++) {
    uint32_t at = references[i];
    if (at >= VALID) return unknown(unit, at);
    if (at < COMMAND || at >= OUTPUT) return tell(unit, ERROR, "Time and outputs cannot be set.");
    if (at >= START && unit->data.mode > INITIALIZING) return tell(unit, ERROR, "A start value cannot be set once stepping has begun.");
    if (!isfinite(values[i]) || values[i] < VARIABLE[at].least || values[i] > VARIABLE[at].most) {
      snprintf(text, sizeof text, "%s is %.17g; allowed is a number from %g to %g.", VARIABLE[at].name, values[i], VARIABLE[at].least,
               VARIABLE[at].most);
      return tell(unit, ERROR, text);
    }
  }
  for (size_t i = 0; i < n; i++) unit->data.value[references[i]] = values[i];
  if (n) unit->data.stale = 1;
  return OK;
}

Status fmi3DoStep(Unit *unit, double point, double step, bool no_restore, bool *event, bool *terminate, bool *early, double *last) {
  Data *data = &unit->data;
  char text[200];
  (void)no_restore;
  *event = *terminate = *early = false;
  *last = data->time;
  if (data->mode != STEPPING) return tell(unit, ERROR, "A step cannot be taken before initialization has ended or after termination.");
  if (!(fabs(point - data->time) <= 1e-9 * fmax(1.0, fabs(point)))) {
    snprintf(text, sizeof text, "The communication point is %.17g s; the unit is at %.17g s.", point, data->time);
    return tell(unit, ERROR, text);
  }
  double count = round(step / DT);
  if (!(count >= 1.0 && count <= 1e10 && fabs(count * DT - step) <= 1e-6 * DT)) {
    snprintf(text, sizeof text, "The communication step is %.17g s; allowed is a multiple of the physics step of %g s.", step, DT);
    return tell(unit, DISCARD, text);
  }
  loop(data, (int64_t)count);
  data->invalid |= !isinf(data->summary[AT_INVALID]);
  double fastest = 0.0;
  for (int i = STATES / 2; i < STATES; i++) fastest = fastest > fabs(data->state[i]) || isnan(fastest) ? fastest : fabs(data->state[i]);
  if (!(fastest < 1e6)) {
    snprintf(text, sizeof text, "The run diverged between %.6g and %.6g s: a joint moves at %g per second.", point, point + step, fastest);
    return tell(unit, ERROR, text);
  }
  data->time = data->value[0] = *last = point + step;
  data->stale = 1;
  return OK;
}

Status fmi3GetFMUState(Unit *unit, Data **saved) {
  if (!*saved) *saved = malloc(sizeof **saved);
  if (!*saved) return tell(unit, ERROR, "There is no memory for the state.");
  **saved = unit->data;
  return OK;
}

Status fmi3SetFMUState(Unit *unit, const Data *saved) {
  unit->data = *saved;
  return OK;
}

Status fmi3FreeFMUState(Unit *unit, Data **saved) {
  (void)unit;
  if (saved) free(*saved), *saved = NULL;
  return OK;
}

/* A state goes elsewhere with the token of its unit before it, so that no other unit takes it. */
enum { HEAD = sizeof TOKEN };

Status fmi3SerializedFMUStateSize(Unit *unit, const Data *saved, size_t *size) {
  (void)unit, (void)saved;
  *size = HEAD + sizeof *saved;
  return OK;
}

Status fmi3SerializeFMUState(Unit *unit, const Data *saved, unsigned char *bytes, size_t size) {
  if (size < HEAD + sizeof *saved) return tell(unit, ERROR, "The memory for the state is too small.");
  memcpy(bytes, TOKEN, HEAD);
  memcpy(bytes + HEAD, saved, sizeof *saved);
  return OK;
}

Status fmi3DeserializeFMUState(Unit *unit, const unsigned char *bytes, size_t size, Data **saved) {
  if (size != HEAD + sizeof **saved || memcmp(bytes, TOKEN, HEAD)) return tell(unit, ERROR, "This is no state of this unit.");
  if (!*saved) *saved = malloc(sizeof **saved);
  if (!*saved) return tell(unit, ERROR, "There is no memory for the state.");
  memcpy(*saved, bytes + HEAD, sizeof **saved);
  return OK;
}

/* There are no variables of these types; asked for none, they answer. */
#define NONE(type)                                                                                                   \
  Status fmi3Get##type(Unit *unit, const uint32_t *references, size_t n) { return n ? unknown(unit, *references) : OK; } \
  Status fmi3Set##type(Unit *unit, const uint32_t *references, size_t n) { return n ? unknown(unit, *references) : OK; }
NONE(Float32) NONE(Int8) NONE(UInt8) NONE(Int16) NONE(UInt16) NONE(Int32) NONE(UInt32) NONE(Int64) NONE(UInt64) NONE(String)
NONE(Binary) NONE(Clock)

Status fmi3SetBoolean(Unit *unit, const uint32_t *references, size_t n) { return n ? unknown(unit, *references) : OK; }

/* What belongs to model exchange, events, clocks and derivatives, none of which this unit says it has. */
#define ABSENT(name) \
  Status fmi3##name(Unit *unit) { return tell(unit, ERROR, "This unit has no fmi3" #name "."); }
ABSENT(EnterEventMode) ABSENT(GetNumberOfVariableDependencies) ABSENT(GetVariableDependencies) ABSENT(GetDirectionalDerivative)
ABSENT(GetAdjointDerivative) ABSENT(EnterConfigurationMode) ABSENT(ExitConfigurationMode) ABSENT(GetIntervalDecimal)
ABSENT(GetIntervalFraction) ABSENT(GetShiftDecimal) ABSENT(GetShiftFraction) ABSENT(SetIntervalDecimal) ABSENT(SetIntervalFraction)
ABSENT(SetShiftDecimal) ABSENT(SetShiftFraction) ABSENT(EvaluateDiscreteStates) ABSENT(UpdateDiscreteStates)
ABSENT(EnterContinuousTimeMode) ABSENT(CompletedIntegratorStep) ABSENT(SetTime) ABSENT(SetContinuousStates)
ABSENT(GetContinuousStateDerivatives) ABSENT(GetEventIndicators) ABSENT(GetContinuousStates) ABSENT(GetNominalsOfContinuousStates)
ABSENT(GetNumberOfEventIndicators) ABSENT(GetNumberOfContinuousStates) ABSENT(EnterStepMode) ABSENT(GetOutputDerivatives)
ABSENT(ActivateModelPartition)

/* What units of FMI 2 and FMI 3 share: variables, modes, steps and saved states of a function block.

   unit.h, written for each unit, includes the block and defines TOKEN, DT, RESET, STEP, OUTPUTS if the block has it, LAST_COUNT,
   STATES, START, FIRST_STATE, and the table VARIABLE. Value reference 0 is time; that of the last variable is validity. */

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "unit.h"

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED } Mode;

enum { VARIABLES = sizeof VARIABLE / sizeof *VARIABLE, VALID = VARIABLES - 1 };

typedef struct Unit Unit;
struct Unit {
  Data data;
  void *environment;
  void (*log)(Unit *unit, Status status, const char *message);
  void (*callback)(void);
  const char *name;
};

static Status tell(Unit *unit, Status status, const char *format, ...) {
  char text[240];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  if (unit->callback) unit->log(unit, status, text);
  return status;
}

static double *at(Data *data, size_t reference) { return (double *)(void *)((char *)data + VARIABLE[reference].offset); }

static void begin(Data *data) {
  memset(data, 0, sizeof *data);
  RESET(&data->model);
  for (size_t i = START; i < START + STATES; i++) *at(data, i) = VARIABLE[i].start;
  data->stale = 1;
}

/* Outputs at the present state under the present inputs. */
static void look(Data *data) {
  if (!data->stale) return;
  if (data->mode <= INITIALIZING)
    for (size_t i = 0; i < STATES; i++) *at(data, FIRST_STATE + i) = *at(data, START + i);
#ifdef OUTPUTS
  /* Solvers of model exchange try states and take them back, so what does not hold at a state is no fault of later ones. */
  data->model.fault = false;
  data->sound = OUTPUTS(&data->model);
  data->valid = data->model.valid > 0.5 && !data->invalid;
#else
  /* The block is asked in a copy: looking does not advance its memory, and at a fault not its ramps. */
  Data next = *data;
  data->valid = STEP(&next.model);
  for (size_t i = 0; i < VALID; i++)
    if (VARIABLE[i].output) *at(data, i) = *at(&next, i);
#endif
  data->stale = 0;
}

static Status unknown(Unit *unit, uint32_t reference) {
  return tell(unit, ERROR, "There is no such variable with value reference %u.", (unsigned)reference);
}

static Status get_real(Unit *unit, const uint32_t *references, size_t n, double *values) {
  look(&unit->data);
  for (size_t i = 0; i < n; i++) {
    if (references[i] >= VALID) return unknown(unit, references[i]);
    values[i] = *at(&unit->data, references[i]);
  }
  return OK;
}

static Status get_valid(Unit *unit, const uint32_t *references, size_t n) {
  look(&unit->data);
  for (size_t i = 0; i < n; i++)
    if (references[i] != VALID) return unknown(unit, references[i]);
  return OK;
}

static Status set_real(Unit *unit, const uint32_t *references, size_t n, const double *values) {
  for (size_t i = 0; i < n; i++) {
    uint32_t reference = references[i];
    if (reference >= VALID) return unknown(unit, reference);
    if (!reference || VARIABLE[reference].output) return tell(unit, ERROR, "Time and outputs cannot be set.");
    if (VARIABLE[reference].fixed && unit->data.mode > INITIALIZING)
      return tell(unit, ERROR, "%s cannot be set once stepping has begun.", VARIABLE[reference].name);
    if (!isfinite(values[i]) || values[i] < VARIABLE[reference].least || values[i] > VARIABLE[reference].most)
      return tell(unit, ERROR, "%s is %.17g; allowed is a number from %g to %g.", VARIABLE[reference].name, values[i],
                  VARIABLE[reference].least, VARIABLE[reference].most);
  }
  for (size_t i = 0; i < n; i++) *at(&unit->data, references[i]) = values[i];
  if (n) unit->data.stale = 1;
  return OK;
}

static Status enter_initialization(Unit *unit, double start) {
  if (unit->data.mode != INSTANTIATED) return tell(unit, ERROR, "Initialization has begun before; reset first.");
  unit->data.mode = INITIALIZING;
  unit->data.time = start;
  unit->data.stale = 1;
  return OK;
}

static Status exit_initialization(Unit *unit) {
  if (unit->data.mode != INITIALIZING) return tell(unit, ERROR, "Initialization has not begun.");
  unit->data.stale = 1;
  look(&unit->data);
  unit->data.mode = STEPPING;
  return OK;
}

static Status advance(Unit *unit, double point, double step) {
  Data *data = &unit->data;
  if (data->mode != STEPPING) return tell(unit, ERROR, "A step cannot be taken before initialization has ended or after termination.");
  if (!(fabs(point - data->time) <= 1e-9 * fmax(1.0, fabs(point))))
    return tell(unit, ERROR, "The communication point is %.17g s; the unit is at %.17g s.", point, data->time);
  double count = round(step / DT);
  if (!(count >= 1.0 && count <= 1e10 && fabs(count * DT - step) <= 1e-6 * DT))
    return tell(unit, DISCARD, "The communication step is %.17g s; allowed is a multiple of its own step of %g s.", step, DT);
  look(data);
  data->invalid |= !data->valid;
  bool sound = true;
  for (int64_t i = 0; i < (int64_t)count; i++) sound = STEP(&data->model) && sound;
  double fastest = 0.0;
  for (size_t i = STATES / 2; i < STATES; i++) {
    double rate = fabs(*at(data, FIRST_STATE + i));
    fastest = fastest > rate || isnan(fastest) ? fastest : rate;
  }
  if (!(fastest < 1e6))
    return tell(unit, ERROR, "The run diverged between %.6g and %.6g s: a joint moves at %g per second.", point, point + step, fastest);
  if (!sound && STATES)
    return tell(unit, ERROR, "The run ended between %.6g and %.6g s: an input lies beyond 1e12, or the state is no number any more.",
                point, point + step);
  data->time = point + step;
  data->stale = 1;
  return OK;
}

static Status get_states(Unit *unit, double *states, size_t n) {
  if (n != STATES) return tell(unit, ERROR, "The unit has %d states.", STATES);
  look(&unit->data);
  for (size_t i = 0; i < n; i++) states[i] = *at(&unit->data, FIRST_STATE + i);
  return OK;
}

static Status set_states(Unit *unit, const double *states, size_t n) {
  if (n != STATES) return tell(unit, ERROR, "The unit has %d states.", STATES);
  for (size_t i = 0; i < n; i++)
    if (!isfinite(states[i]))
      return tell(unit, DISCARD, "%s is %.17g; a state is a finite number.", VARIABLE[FIRST_STATE + i].name, states[i]);
  for (size_t i = 0; i < n; i++) *at(&unit->data, FIRST_STATE + i) = states[i];
  unit->data.stale = 1;
  return OK;
}

/* Rates of the states: the second half of them, then accelerations. */
static Status get_derivatives(Unit *unit, double *derivatives, size_t n) {
  if (n != STATES) return tell(unit, ERROR, "The unit has %d states.", STATES);
  look(&unit->data);
  if (STATES && !unit->data.sound)
    return tell(unit, DISCARD, "There are no derivatives here: an input lies beyond 1e12, or they are no numbers at this state.");
  for (size_t i = 0; i < n; i++) derivatives[i] = *at(&unit->data, FIRST_STATE + STATES / 2 + i);
  return OK;
}

static Status save(Unit *unit, Data **saved) {
  if (!*saved) *saved = malloc(sizeof **saved);
  if (!*saved) return tell(unit, ERROR, "There is no memory for the state.");
  **saved = unit->data;
  return OK;
}

static void forget(Data **saved) {
  if (saved) free(*saved), *saved = NULL;
}

/* A state goes elsewhere with the token of its unit before it, so that no other unit takes it. */
enum { HEAD = sizeof TOKEN };

static Status serialize(Unit *unit, const Data *saved, unsigned char *bytes, size_t size) {
  if (size < HEAD + sizeof *saved) return tell(unit, ERROR, "The memory for the state is too small.");
  memcpy(bytes, TOKEN, HEAD);
  memcpy(bytes + HEAD, saved, sizeof *saved);
  return OK;
}

static bool is_flag(int32_t value) { return value == 0 || value == 1; }

/* Whether bytes that come from elsewhere are a state that this unit could have had. The count of calls is an index of tables, and a
   bool that is neither 0 nor 1 may not even be read in C. */
static bool is_state(const Data *data) {
  unsigned char fault;
  memcpy(&fault, (const unsigned char *)data + offsetof(Data, model.fault), 1);
  if (fault > 1 || data->model.count < 0 || data->model.count > LAST_COUNT) return false;
  if (data->mode < INSTANTIATED || data->mode > TERMINATED || !isfinite(data->time)) return false;
  if (!is_flag(data->stale) || !is_flag(data->invalid) || !is_flag(data->valid) || !is_flag(data->sound)) return false;
  /* All numbers of the block stand before its count. */
  const double *numbers = (const double *)(const void *)&data->model;
  size_t n = (offsetof(Data, model.count) - offsetof(Data, model)) / sizeof *numbers;
  for (size_t i = 0; i < n; i++)
    if (!isfinite(numbers[i])) return false;
  for (size_t i = 1; i < VALID; i++) {
    double value = *(const double *)(const void *)((const char *)data + VARIABLE[i].offset);
    if (!VARIABLE[i].output && !(isfinite(value) && value >= VARIABLE[i].least && value <= VARIABLE[i].most)) return false;
  }
  return true;
}

static Status deserialize(Unit *unit, const unsigned char *bytes, size_t size, Data **saved) {
  if (size != HEAD + sizeof **saved || memcmp(bytes, TOKEN, HEAD)) return tell(unit, ERROR, "This is no state of this unit.");
  Data *data = malloc(sizeof *data);
  if (!data) return tell(unit, ERROR, "There is no memory for the state.");
  memcpy(data, bytes + HEAD, sizeof *data);
  if (!is_state(data)) {
    free(data);
    return tell(unit, ERROR, "The bytes of the state are damaged: a number in them is outside of what this unit can have.");
  }
  if (*saved) {
    **saved = *data;
    free(data);
  } else {
    *saved = data;
  }
  return OK;
}

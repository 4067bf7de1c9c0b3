/* Functions of FMI 2 and FMI 3 that differ in their names alone: FMI and SAVED make them, DERIVATIVES and DESERIALIZE are two. */

#include "fmi_unit.h"

EXPORT void FMI(FreeInstance)(Unit *unit) { free(unit); }
EXPORT Status FMI(ExitInitializationMode)(Unit *unit) { return exit_initialization(unit); }

EXPORT Status FMI(Terminate)(Unit *unit) {
  unit->data.mode = TERMINATED;
  return OK;
}

EXPORT Status FMI(Reset)(Unit *unit) {
  begin(&unit->data);
  return OK;
}

EXPORT Status SAVED(Get, )(Unit *unit, Data **saved) { return save(unit, saved); }

EXPORT Status SAVED(Set, )(Unit *unit, const Data *saved) {
  unit->data = *saved;
  return OK;
}

EXPORT Status SAVED(Free, )(Unit *unit, Data **saved) {
  (void)unit;
  forget(saved);
  return OK;
}

EXPORT Status SAVED(Serialized, Size)(Unit *unit, const Data *saved, size_t *size) {
  (void)unit, (void)saved;
  *size = HEAD + sizeof *saved;
  return OK;
}

EXPORT Status SAVED(Serialize, )(Unit *unit, const Data *saved, unsigned char *bytes, size_t size) {
  return serialize(unit, saved, bytes, size);
}

EXPORT Status DESERIALIZE(Unit *unit, const unsigned char *bytes, size_t size, Data **saved) { return deserialize(unit, bytes, size, saved); }

/* Model exchange; there are no events. */
EXPORT Status FMI(EnterEventMode)(Unit *unit) { return (void)unit, OK; }
EXPORT Status FMI(EnterContinuousTimeMode)(Unit *unit) { return (void)unit, OK; }

EXPORT Status FMI(SetTime)(Unit *unit, double time) {
  unit->data.time = time;
  return OK;
}

EXPORT Status FMI(GetContinuousStates)(Unit *unit, double *states, size_t n) { return get_states(unit, states, n); }
EXPORT Status FMI(SetContinuousStates)(Unit *unit, const double *states, size_t n) { return set_states(unit, states, n); }
EXPORT Status DERIVATIVES(Unit *unit, double *derivatives, size_t n) { return get_derivatives(unit, derivatives, n); }
EXPORT Status FMI(GetEventIndicators)(Unit *unit, double *indicators, size_t n) { return (void)unit, (void)indicators, (void)n, OK; }

EXPORT Status FMI(GetNominalsOfContinuousStates)(Unit *unit, double *nominals, size_t n) {
  (void)unit;
  for (size_t i = 0; i < n; i++) nominals[i] = 1.0;
  return OK;
}

/* There are no variables of such a type; asked for none, they answer. */
#define NONE(type)                                                                                                                 \
  EXPORT Status FMI(Get##type)(Unit *unit, const uint32_t *references, size_t n) { return n ? unknown(unit, *references) : OK; } \
  EXPORT Status FMI(Set##type)(Unit *unit, const uint32_t *references, size_t n) { return n ? unknown(unit, *references) : OK; }

/* What this unit says it does not have. */
#define ABSENT(name) \
  EXPORT Status FMI(name)(Unit *unit) { return tell(unit, ERROR, "This unit has no " #name "."); }

/* Copyright 2026 The hyst_control authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * {{ name }}: co-simulation by FMI 2.0 around {{ name }}_settle and {{ name }}_step.
 *
 * Leaving the initialization mode settles at the inputs that are set by then; every tick of {{ sample_time }} s is one step with the
 * inputs held. A communication step is a whole number of ticks.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "{{ name }}.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { OK = 0, DISCARD = 2, ERROR = 3 }; /* fmi2Status */
enum { INPUTS = {{ upper }}_INPUTS, OUTPUTS = {{ upper }}_OUTPUTS };

typedef struct {
    void (*log)(void *environment, const char *instance, int status, const char *category, const char *message, ...);
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*finished)(void *environment, int status);
    void *environment;
} Callbacks;

typedef struct {
    {{ name }}_state state;
    {{ name }}_real in[INPUTS];
    {{ name }}_real out[OUTPUTS];
    double time;
} Memory;

typedef struct {
    Memory memory;
    const Callbacks *callbacks;
    char *name;
} Instance;

static int failed(const Instance *instance, const char *message)
{
    if (instance->callbacks->log != NULL) {
        instance->callbacks->log(instance->callbacks->environment, instance->name, ERROR, "error", message);
    }
    return ERROR;
}

static void begin(Memory *memory)
{
    memset(memory, 0, sizeof *memory);
    {{ name }}_init(&memory->state);
    {{ name }}_settle(&memory->state, memory->in, memory->out);
}

EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORT const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORT int fmi2SetDebugLogging(void *self, int on, size_t count, const char *const categories[])
{
    (void)self, (void)on, (void)count, (void)categories;
    return OK;
}

EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const Callbacks *callbacks,
                             int visible, int logging)
{
    (void)resources, (void)visible, (void)logging;
    if (type != 1 || callbacks == NULL || guid == NULL || strcmp(guid, "{{ guid }}") != 0) {
        return NULL;
    }
    Instance *instance = calloc(1, sizeof *instance);
    const size_t length = (name == NULL) ? 0 : strlen(name);
    char *copy = calloc(length + 1, 1);
    if (instance == NULL || copy == NULL) {
        free(instance);
        free(copy);
        return NULL;
    }
    memcpy(copy, (name == NULL) ? "" : name, length);
    instance->name = copy;
    instance->callbacks = callbacks;
    begin(&instance->memory);
    return instance;
}

EXPORT void fmi2FreeInstance(void *self)
{
    if (self != NULL) {
        free(((Instance *)self)->name);
        free(self);
    }
}

EXPORT int fmi2SetupExperiment(void *self, int tolerance_defined, double tolerance, double start, int stop_defined, double stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Instance *)self)->memory.time = start;
    return OK;
}

EXPORT int fmi2EnterInitializationMode(void *self)
{
    (void)self;
    return OK;
}

EXPORT int fmi2ExitInitializationMode(void *self)
{
    Memory *memory = &((Instance *)self)->memory;
    {{ name }}_settle(&memory->state, memory->in, memory->out);
    return OK;
}

EXPORT int fmi2Terminate(void *self)
{
    (void)self;
    return OK;
}

EXPORT int fmi2Reset(void *self)
{
    begin(&((Instance *)self)->memory);
    return OK;
}

EXPORT int fmi2SetReal(void *self, const unsigned int references[], size_t count, const double values[])
{
    Instance *instance = self;
    for (size_t i = 0; i < count; i++) {
        if (references[i] >= (unsigned int)INPUTS) {
            return failed(instance, "fmi2SetReal: only inputs can be set");
        }
        instance->memory.in[references[i]] = ({{ name }}_real)values[i];
    }
    return OK;
}

EXPORT int fmi2GetReal(void *self, const unsigned int references[], size_t count, double values[])
{
    Instance *instance = self;
    for (size_t i = 0; i < count; i++) {
        const unsigned int at = references[i];
        if (at >= (unsigned int)(INPUTS + OUTPUTS)) {
            return failed(instance, "fmi2GetReal: no variable has this value reference");
        }
        values[i] = (double)((at < (unsigned int)INPUTS) ? instance->memory.in[at] : instance->memory.out[at - INPUTS]);
    }
    return OK;
}

EXPORT int fmi2DoStep(void *self, double time, double step, int no_set_before)
{
    Instance *instance = self;
    Memory *memory = &instance->memory;
    const double ticks = floor((step / {{ upper }}_SAMPLE_TIME) + 0.5);
    (void)no_set_before;
    if (!(ticks >= 1.0) || fabs(step - (ticks * {{ upper }}_SAMPLE_TIME)) > (1e-6 * {{ upper }}_SAMPLE_TIME * ticks)) {
        return failed(instance, "fmi2DoStep: the communication step must be a whole number of ticks of {{ sample_time }} s");
    }
    for (double tick = 0.0; tick < ticks; tick += 1.0) {
        {{ name }}_step(&memory->state, memory->in, memory->out);
    }
    memory->time = time + step;
    return OK;
}

EXPORT int fmi2GetFMUstate(void *self, void **state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(Memory));
    }
    if (*state == NULL) {
        return failed(self, "fmi2GetFMUstate: no memory");
    }
    memcpy(*state, &((Instance *)self)->memory, sizeof(Memory));
    return OK;
}

EXPORT int fmi2SetFMUstate(void *self, void *state)
{
    memcpy(&((Instance *)self)->memory, state, sizeof(Memory));
    return OK;
}

EXPORT int fmi2FreeFMUstate(void *self, void **state)
{
    (void)self;
    free(*state);
    *state = NULL;
    return OK;
}

EXPORT int fmi2SerializedFMUstateSize(void *self, void *state, size_t *size)
{
    (void)self, (void)state;
    *size = sizeof(Memory);
    return OK;
}

EXPORT int fmi2SerializeFMUstate(void *self, void *state, char bytes[], size_t size)
{
    if (size < sizeof(Memory)) {
        return failed(self, "fmi2SerializeFMUstate: too little room");
    }
    memcpy(bytes, state, sizeof(Memory));
    return OK;
}

EXPORT int fmi2DeSerializeFMUstate(void *self, const char bytes[], size_t size, void **state)
{
    if (size != sizeof(Memory)) {
        return failed(self, "fmi2DeSerializeFMUstate: not a state of this unit");
    }
    if (*state == NULL) {
        *state = malloc(sizeof(Memory));
    }
    if (*state == NULL) {
        return failed(self, "fmi2DeSerializeFMUstate: no memory");
    }
    memcpy(*state, bytes, sizeof(Memory));
    return OK;
}

EXPORT int fmi2GetRealStatus(void *self, int kind, double *value)
{
    if (kind != 2) { /* last successful time */
        return DISCARD;
    }
    *value = ((Instance *)self)->memory.time;
    return OK;
}

/* All variables are real, and a step ends before fmi2DoStep returns. */

#define NONE(name, type)                                                                            \
    EXPORT int name(void *self, const unsigned int references[], size_t count, type values[])      \
    {                                                                                              \
        (void)references, (void)values;                                                            \
        return (count == 0) ? OK : failed(self, #name ": all variables are real");                 \
    }

NONE(fmi2GetInteger, int)
NONE(fmi2SetInteger, const int)
NONE(fmi2GetBoolean, int)
NONE(fmi2SetBoolean, const int)
NONE(fmi2GetString, const char *)
NONE(fmi2SetString, const char *const)

EXPORT int fmi2GetDirectionalDerivative(void *self, const unsigned int unknown[], size_t unknowns, const unsigned int known[],
                                        size_t knowns, const double moved[], double answer[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)moved, (void)answer;
    return failed(self, "fmi2GetDirectionalDerivative: is not provided");
}

EXPORT int fmi2SetRealInputDerivatives(void *self, const unsigned int references[], size_t count, const int orders[],
                                       const double values[])
{
    (void)references, (void)count, (void)orders, (void)values;
    return failed(self, "fmi2SetRealInputDerivatives: inputs are held");
}

EXPORT int fmi2GetRealOutputDerivatives(void *self, const unsigned int references[], size_t count, const int orders[],
                                        double values[])
{
    (void)references, (void)count, (void)orders, (void)values;
    return failed(self, "fmi2GetRealOutputDerivatives: is not provided");
}

EXPORT int fmi2CancelStep(void *self)
{
    return failed(self, "fmi2CancelStep: a step has ended when fmi2DoStep returns");
}

{% for kind, type in [("", "int *"), ("Integer", "int *"), ("Boolean", "int *"), ("String", "const char **")] %}
EXPORT int fmi2Get{{ kind }}Status(void *self, int kind, {{ type }}value)
{
    (void)self, (void)kind, (void)value;
    return DISCARD;
}
{{ "" if loop.last else "\n" }}
{%- endfor %}

/* opencl_gpu.c - a libOpenCL.so.1 that passes calls on to another one, whose devices it presents as
 * GPUs with memory of their own. Environment variables:
 *  - FAKE_OPENCL_REAL=PATH: the other library;
 *  - FAKE_OPENCL_MEMORY=BYTES: memory of each device (1 GiB);
 *  - FAKE_OPENCL_SINGLE=1: the devices have no double precision;
 *  - FAKE_OPENCL_FAIL=CALL:N:CODE: the Nth call of a function fails with CODE, and so do all later
 *    calls that do work, as on a GPU that was lost; with CALL:N:CODE:once, later calls work.
 * As with NVIDIA's driver, an event has times only after a wait for that event, and threads must
 * not wait for one before it is complete, which would keep a processor busy. */
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <dlfcn.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static unsigned calls;
static cl_int lost;

static void *find(const char *call)
{
    void *library = dlopen(getenv("FAKE_OPENCL_REAL"), RTLD_NOW | RTLD_LOCAL);
    void *function = library ? dlsym(library, call) : NULL;

    if (!function)
        abort();
    return function;
}

/* Returns the code with which a call must fail, or CL_SUCCESS. */
static cl_int begin(const char *call)
{
    const char *setting = getenv("FAKE_OPENCL_FAIL");
    char name[64] = "", once[8] = "";
    unsigned number = 0;
    int failure = 0;
    cl_int code;

    if (setting && sscanf(setting, "%63[^:]:%u:%d:%7s", name, &number, &failure, once) < 3)
        abort();
    pthread_mutex_lock(&lock);
    code = lost;
    if (setting && !code && strcmp(call, name) == 0 && ++calls == number) {
        code = failure;
        lost = once[0] ? CL_SUCCESS : failure;
    }
    pthread_mutex_unlock(&lock);
    return code;
}

/* Functions that return a code, and functions that return an object. */
#define CODE(name, parameters, arguments)                                                          \
    CL_API_ENTRY cl_int CL_API_CALL name parameters                                                \
    {                                                                                              \
        __typeof__(name) *real = (__typeof__(name) *)find(#name);                                  \
        const cl_int code = begin(#name);                                                          \
        return code ? code : real arguments;                                                       \
    }
#define OBJECT(type, name, parameters, arguments)                                                  \
    CL_API_ENTRY type CL_API_CALL name parameters                                                  \
    {                                                                                              \
        __typeof__(name) *real = (__typeof__(name) *)find(#name);                                  \
        const cl_int code = begin(#name);                                                          \
        if (code)                                                                                  \
            *error = code;                                                                         \
        return code ? NULL : real arguments;                                                       \
    }
/* Functions that release objects or describe what there is work on a lost device too. */
#define ALWAYS(name, parameters, arguments)                                                        \
    CL_API_ENTRY cl_int CL_API_CALL name parameters                                                \
    {                                                                                              \
        return ((__typeof__(name) *)find(#name))arguments;                                         \
    }

#define WAIT  cl_uint waits, const cl_event *wait, cl_event *event
#define WAIT_ waits, wait, event

/* clang-format off */
ALWAYS(clGetPlatformIDs, (cl_uint n, cl_platform_id *ids, cl_uint *count), (n, ids, count))
ALWAYS(clGetPlatformInfo,
       (cl_platform_id id, cl_platform_info what, size_t bytes, void *out, size_t *needed),
       (id, what, bytes, out, needed))
ALWAYS(clGetDeviceIDs,
       (cl_platform_id id, cl_device_type type, cl_uint n, cl_device_id *ids, cl_uint *count),
       (id, type, n, ids, count))
ALWAYS(clReleaseContext, (cl_context context), (context))
ALWAYS(clReleaseCommandQueue, (cl_command_queue queue), (queue))
ALWAYS(clReleaseMemObject, (cl_mem memory), (memory))
ALWAYS(clReleaseProgram, (cl_program program), (program))
ALWAYS(clReleaseKernel, (cl_kernel kernel), (kernel))
ALWAYS(clGetProgramBuildInfo,
       (cl_program program, cl_device_id id, cl_program_build_info what, size_t bytes, void *out,
        size_t *needed),
       (program, id, what, bytes, out, needed))
OBJECT(cl_context, clCreateContext,
       (const cl_context_properties *properties, cl_uint n, const cl_device_id *ids,
        void (CL_CALLBACK *notify)(const char *, const void *, size_t, void *), void *arg,
        cl_int *error),
       (properties, n, ids, notify, arg, error))
OBJECT(cl_command_queue, clCreateCommandQueue,
       (cl_context context, cl_device_id id, cl_command_queue_properties properties,
        cl_int *error),
       (context, id, properties, error))
OBJECT(cl_mem, clCreateBuffer,
       (cl_context context, cl_mem_flags flags, size_t bytes, void *host, cl_int *error),
       (context, flags, bytes, host, error))
OBJECT(cl_program, clCreateProgramWithSource,
       (cl_context context, cl_uint n, const char **texts, const size_t *lengths, cl_int *error),
       (context, n, texts, lengths, error))
OBJECT(cl_kernel, clCreateKernel, (cl_program program, const char *name, cl_int *error),
       (program, name, error))
OBJECT(void *, clEnqueueMapBuffer,
       (cl_command_queue queue, cl_mem memory, cl_bool blocking, cl_map_flags flags, size_t at,
        size_t bytes, WAIT, cl_int *error),
       (queue, memory, blocking, flags, at, bytes, WAIT_, error))
CODE(clBuildProgram,
     (cl_program program, cl_uint n, const cl_device_id *ids, const char *options,
      void (CL_CALLBACK *notify)(cl_program, void *), void *arg),
     (program, n, ids, options, notify, arg))
CODE(clGetKernelWorkGroupInfo,
     (cl_kernel kernel, cl_device_id id, cl_kernel_work_group_info what, size_t bytes, void *out,
      size_t *needed),
     (kernel, id, what, bytes, out, needed))
CODE(clSetKernelArg, (cl_kernel kernel, cl_uint number, size_t bytes, const void *value),
     (kernel, number, bytes, value))
CODE(clEnqueueWriteBuffer,
     (cl_command_queue queue, cl_mem memory, cl_bool blocking, size_t at, size_t bytes,
      const void *from, WAIT),
     (queue, memory, blocking, at, bytes, from, WAIT_))
CODE(clEnqueueReadBuffer,
     (cl_command_queue queue, cl_mem memory, cl_bool blocking, size_t at, size_t bytes, void *to,
      WAIT),
     (queue, memory, blocking, at, bytes, to, WAIT_))
CODE(clEnqueueNDRangeKernel,
     (cl_command_queue queue, cl_kernel kernel, cl_uint sides, const size_t *at,
      const size_t *items, const size_t *group, WAIT),
     (queue, kernel, sides, at, items, group, WAIT_))
CODE(clGetEventInfo,
     (cl_event event, cl_event_info what, size_t bytes, void *out, size_t *needed),
     (event, what, bytes, out, needed))
CODE(clFlush, (cl_command_queue queue), (queue))
ALWAYS(clEnqueueUnmapMemObject,
       (cl_command_queue queue, cl_mem memory, void *at, WAIT), (queue, memory, at, WAIT_))
/* clang-format on */

/* ---- events ---- */

static cl_event *complete; /* events that somebody waited for, until they are released */
static size_t complete_count;

/* Returns the place of an event in the list: complete_count if it is not there. */
static size_t place_of(cl_event event)
{
    size_t i = 0;

    while (i < complete_count && complete[i] != event)
        i++;
    return i;
}

CL_API_ENTRY cl_int CL_API_CALL clWaitForEvents(cl_uint n, const cl_event *events)
{
    cl_int code = begin("clWaitForEvents");

    for (cl_uint i = 0; i < n; i++) {
        cl_int state = CL_COMPLETE;
        if (!code)
            code = ((__typeof__(clGetEventInfo) *)find("clGetEventInfo"))(
                events[i], CL_EVENT_COMMAND_EXECUTION_STATUS, sizeof state, &state, NULL);
        if (!code && state > CL_COMPLETE) {
            fputs("fake OpenCL: a thread waits busily\n", stderr);
            code = CL_INVALID_OPERATION;
        }
    }
    if (!code)
        code = ((__typeof__(clWaitForEvents) *)find("clWaitForEvents"))(n, events);
    pthread_mutex_lock(&lock);
    for (cl_uint i = 0; !code && i < n; i++)
        if (place_of(events[i]) == complete_count) {
            cl_event *longer = realloc(complete, (complete_count + 1) * sizeof *complete);
            if (!longer)
                abort();
            complete = longer;
            complete[complete_count++] = events[i];
        }
    pthread_mutex_unlock(&lock);
    return code;
}

CL_API_ENTRY cl_int CL_API_CALL clReleaseEvent(cl_event event)
{
    pthread_mutex_lock(&lock);
    const size_t place = place_of(event);
    if (place < complete_count)
        complete[place] = complete[--complete_count];
    pthread_mutex_unlock(&lock);
    return ((__typeof__(clReleaseEvent) *)find("clReleaseEvent"))(event);
}

CL_API_ENTRY cl_int CL_API_CALL clGetEventProfilingInfo(cl_event event, cl_profiling_info what,
                                                        size_t bytes, void *out, size_t *needed)
{
    cl_int code = begin("clGetEventProfilingInfo");

    pthread_mutex_lock(&lock);
    if (!code && place_of(event) == complete_count)
        code = CL_PROFILING_INFO_NOT_AVAILABLE;
    pthread_mutex_unlock(&lock);
    return code ? code
                : ((__typeof__(clGetEventProfilingInfo) *)find("clGetEventProfilingInfo"))(
                      event, what, bytes, out, needed);
}

/* Waits also on a lost device, for what was enqueued before. */
CL_API_ENTRY cl_int CL_API_CALL clFinish(cl_command_queue queue)
{
    cl_int done = ((__typeof__(clFinish) *)find("clFinish"))(queue);
    cl_int code = begin("clFinish");
    return code ? code : done;
}

CL_API_ENTRY cl_int CL_API_CALL clGetDeviceInfo(cl_device_id id, cl_device_info what, size_t bytes,
                                                void *out, size_t *needed)
{
    const char *memory = getenv("FAKE_OPENCL_MEMORY");
    cl_int code =
        ((__typeof__(clGetDeviceInfo) *)find("clGetDeviceInfo"))(id, what, bytes, out, needed);
    cl_ulong number = memory ? strtoull(memory, NULL, 10) : (cl_ulong)1 << 30;

    if (code != CL_SUCCESS || !out)
        return code;
    if (what == CL_DEVICE_TYPE)
        number = CL_DEVICE_TYPE_GPU;
    else if (what == CL_DEVICE_HOST_UNIFIED_MEMORY ||
             (what == CL_DEVICE_DOUBLE_FP_CONFIG && getenv("FAKE_OPENCL_SINGLE")))
        number = 0;
    else if (what != CL_DEVICE_GLOBAL_MEM_SIZE)
        return code;
    memcpy(out, &number, bytes < sizeof number ? bytes : sizeof number);
    return code;
}

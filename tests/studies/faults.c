/* Causes system faults in a run, for tests; load it before the C library with LD_PRELOAD.

These functions cause the faults:
faults_log     every change of files "study.*" and ".study.*" goes to a file, in order
faults_clock   the wall clock jumps by years, both ways, every few reads; the argument is a seed
faults_locks   file locks fail, as on a network file system without locks
faults_memory  allocations fail after the given number of allocations */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define REAL(result, name, ...)                                                 \
    static result (*real)(__VA_ARGS__);                                         \
    if (!real) real = (result(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

/* Changes of files */

#define MOST 4096
static int noted = -1;
static char watched[MOST];
static pthread_mutex_t guard = PTHREAD_MUTEX_INITIALIZER;

static int is_ours(const char *path) {
    const char *name = strrchr(path, '/');
    name = name ? name + 1 : path;
    return !strncmp(name, "study.", 6) || !strncmp(name, ".study.", 7);
}

static void put(const void *data, size_t size) {
    REAL(ssize_t, "write", int, const void *, size_t);
    while (size) {
        ssize_t done = real(noted, data, size);
        if (done <= 0) abort();
        data = (const char *)data + done;
        size -= done;
    }
}

static void note(char kind, int file, int64_t at, const void *data, int64_t size) {
    int64_t head[4] = {kind, file, at, size};
    put(head, sizeof head);
    put(data, size);
}

void faults_log(const char *log) {
    REAL(int, "open", const char *, int, ...);
    noted = real(log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
}

static int opened(int file, const char *path, int flags) {
    struct stat about;
    if (noted < 0 || file < 0 || file >= MOST) return file;
    watched[file] = 0;
    if (is_ours(path)) watched[file] = 1;
    else if (!fstat(file, &about) && S_ISDIR(about.st_mode)) watched[file] = 2;
    if (watched[file]) note(watched[file] == 2 ? 'D' : 'O', file, flags & O_TRUNC, path, strlen(path));
    return file;
}

#define OPEN(name)                                                              \
    int name(const char *path, int flags, ...) {                                \
        REAL(int, #name, const char *, int, ...);                               \
        va_list more;                                                           \
        va_start(more, flags);                                                  \
        int mode = va_arg(more, int);                                           \
        va_end(more);                                                           \
        if (noted < 0) return real(path, flags, mode);                          \
        pthread_mutex_lock(&guard);                                             \
        int file = opened(real(path, flags, mode), path, flags);                \
        pthread_mutex_unlock(&guard);                                           \
        return file;                                                            \
    }
OPEN(open)
OPEN(open64)

#define NOTED(result, name, kind, file, at, data, size, parameters, arguments, ...) \
    result name parameters {                                                    \
        REAL(result, #name, __VA_ARGS__);                                       \
        if (noted < 0 || file < 0 || file >= MOST || !watched[file]) return real arguments; \
        pthread_mutex_lock(&guard);                                             \
        result found = real arguments;                                          \
        if (found >= 0) note(kind, file, at, data, size);                       \
        pthread_mutex_unlock(&guard);                                           \
        return found;                                                           \
    }
NOTED(ssize_t, pwrite, 'W', file, at, data, found, (int file, const void *data, size_t size, off_t at),
      (file, data, size, at), int, const void *, size_t, off_t)
NOTED(ssize_t, pwrite64, 'W', file, at, data, found, (int file, const void *data, size_t size, off64_t at),
      (file, data, size, at), int, const void *, size_t, off64_t)
NOTED(int, ftruncate, 'T', file, size, "", 0, (int file, off_t size), (file, size), int, off_t)
NOTED(int, ftruncate64, 'T', file, size, "", 0, (int file, off64_t size), (file, size), int, off64_t)
NOTED(int, fsync, 'S', file, 0, "", 0, (int file), (file), int)
NOTED(int, fdatasync, 'S', file, 0, "", 0, (int file), (file), int)

int unlink(const char *path) {
    REAL(int, "unlink", const char *);
    if (noted < 0 || !is_ours(path)) return real(path);
    pthread_mutex_lock(&guard);
    int found = real(path);
    if (!found) note('U', 0, 0, path, strlen(path));
    pthread_mutex_unlock(&guard);
    return found;
}

int rename(const char *before, const char *after) {
    REAL(int, "rename", const char *, const char *);
    if (noted < 0 || !is_ours(after)) return real(before, after);
    pthread_mutex_lock(&guard);
    int found = real(before, after);
    if (!found) {
        note('R', 0, 0, before, strlen(before));
        note('R', 1, 0, after, strlen(after));
    }
    pthread_mutex_unlock(&guard);
    return found;
}

/* Locks */

static int lockless = 0;

void faults_locks(void) { lockless = 1; }

#define FCNTL(name)                                                             \
    int name(int file, int command, ...) {                                      \
        REAL(int, #name, int, int, ...);                                        \
        va_list more;                                                           \
        va_start(more, command);                                                \
        void *given = va_arg(more, void *);                                     \
        va_end(more);                                                           \
        if ((command == F_SETLK || command == F_SETLKW || command == F_GETLK) && lockless) { \
            errno = ENOLCK;                                                     \
            return -1;                                                          \
        }                                                                       \
        return real(file, command, given);                                      \
    }
FCNTL(fcntl)
FCNTL(fcntl64)

/* Memory */

void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
static atomic_long until = -1, failing = 0, failed = 0;

long faults_memory(long after, long count) {
    failing = count;
    until = after;
    return failed;
}

static int lacking(void) {
    if (until < 0 || --until >= 0) return 0;
    if (failing-- > 0) {
        until = 0;
        failed++;
        errno = ENOMEM;
        return 1;
    }
    until = -1;
    return 0;
}

void *malloc(size_t size) { return lacking() ? NULL : __libc_malloc(size); }
void *calloc(size_t count, size_t size) { return lacking() ? NULL : __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { return lacking() ? NULL : __libc_realloc(old, size); }

/* Clocks: only the wall clock, because the other clocks never go back */

static atomic_ulong state = 0;

void faults_clock(unsigned long seed) { state = 2 * seed + 1; }

static time_t jumped(void) {
    static atomic_long by = 0;
    if (!state) return 0;
    state = state * 6364136223846793005UL + 1442695040888963407UL;
    if ((state >> 33) % 8 == 0) by = (long)((state >> 36) % 630720000UL) - 315360000L;
    return by;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    REAL(int, "clock_gettime", clockid_t, struct timespec *);
    int found = real(clock, now);
    if (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE) now->tv_sec += jumped();
    return found;
}

int gettimeofday(struct timeval *now, void *zone) {
    REAL(int, "gettimeofday", struct timeval *, void *);
    int found = real(now, zone);
    now->tv_sec += jumped();
    return found;
}

time_t time(time_t *now) {
    REAL(time_t, "time", time_t *);
    time_t found = real(NULL) + jumped();
    if (now) *now = found;
    return found;
}

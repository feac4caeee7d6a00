/* Copyright 2026 The hyst_control authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* Preloaded into a process: the n-th call of a kind fails, of files within one folder, or of allocations from some size on. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { NONE, WRITE, OPEN, RENAME, READ, ALLOCATION };
static int kind, keeps_failing;
static long left, failed;
static size_t least;
static char folder[PATH_MAX];

void fail_nth(int which, long n, const char *within, size_t bytes, int keep) {
    snprintf(folder, sizeof folder, "%s", within);
    least = bytes; left = n; if (which) failed = 0; keeps_failing = keep; kind = which;
}
long fail_count(void) { return failed; }

static int due(int which) {
    if (kind != which || (!left && !keeps_failing) || (left && --left)) return 0;
    failed++;
    return 1;
}
/* Relative paths are of the folder: the process works in it. */
static int of_path(const char *path) { return kind && (path[0] != '/' || strncmp(path, folder, strlen(folder)) == 0); }
static int of_file(int fd) {
    char link[64], path[PATH_MAX];
    if (!kind) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, path, sizeof path - 1);
    if (size < 0) return 0;
    path[size] = 0;
    return path[0] == '/' && of_path(path); /* no pipe */
}
#define REAL(name) __typeof__(&name) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)
#define FAILS(which, within, number) if (kind == which && (within) && due(which)) { errno = number; return -1; }

ssize_t write(int fd, const void *data, size_t size) { FAILS(WRITE, of_file(fd), ENOSPC) REAL(write); return real(fd, data, size); }
ssize_t writev(int fd, const struct iovec *data, int count) { FAILS(WRITE, of_file(fd), ENOSPC) REAL(writev); return real(fd, data, count); }
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) { FAILS(WRITE, of_file(fd), ENOSPC) REAL(pwrite64); return real(fd, data, size, at); }
ssize_t read(int fd, void *data, size_t size) { FAILS(READ, of_file(fd), EIO) REAL(read); return real(fd, data, size); }
ssize_t pread64(int fd, void *data, size_t size, off64_t at) { FAILS(READ, of_file(fd), EIO) REAL(pread64); return real(fd, data, size, at); }
int rename(const char *from, const char *to) { FAILS(RENAME, of_path(from), EIO) REAL(rename); return real(from, to); }
int mkdir(const char *path, mode_t mode) { FAILS(OPEN, of_path(path), ENOSPC) REAL(mkdir); return real(path, mode); }
static int opened(const char *name, const char *path, int flags, mode_t mode) {
    FAILS(OPEN, of_path(path) && (!keeps_failing || flags & O_CREAT), keeps_failing ? ENOSPC : ENFILE) /* full for good, or busy once */
    int (*real)(const char *, int, ...) = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, name);
    return real(path, flags, mode);
}
#define OPENED(name) \
    int name(const char *path, int flags, ...) { \
        va_list rest; va_start(rest, flags); mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(rest, mode_t) : 0; va_end(rest); \
        return opened(#name, path, flags, mode); \
    }
OPENED(open)
OPENED(open64)

void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *__libc_realloc(void *, size_t);
#define NO_MEMORY(size) if (kind == ALLOCATION && (size) >= least && due(ALLOCATION)) { errno = ENOMEM; return NULL; }
void *malloc(size_t size) { NO_MEMORY(size) return __libc_malloc(size); }
void *calloc(size_t count, size_t size) { NO_MEMORY(count * size) return __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { NO_MEMORY(size) return __libc_realloc(old, size); }

/* A block's threads, one at a time: each runs until it meets others. See ptx_in_c.py. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>

enum { MOST = 1024, GROUP = 32, STACK = 1 << 20 };

typedef struct {
  ucontext_t context;
  uint32_t tid[3], ntid[3], ctaid[3], nctaid[3], lane, number;
  uint32_t mask, kind, value, distance, found;
  bool is_waiting, is_over;
} Thread;

static Thread threads[MOST];
static Thread* self;
static ucontext_t scheduler;
static uint8_t* stacks;
static const char* fault;
static uint8_t* const* given;
static uint64_t state;

static inline double real(uint64_t bits) { double value; memcpy(&value, &bits, 8); return value; }
static inline uint64_t bits(double value) { uint64_t found; memcpy(&found, &value, 8); return found; }
static inline float short_real(uint32_t bits) { float value; memcpy(&value, &bits, 4); return value; }
static inline uint32_t short_bits(float value) { uint32_t found; memcpy(&found, &value, 4); return found; }
static inline int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }
static inline int64_t most(int64_t a, int64_t b) { return a > b ? a : b; }
static inline uint64_t least_positive(uint64_t a, uint64_t b) { return a < b ? a : b; }
static inline uint64_t most_positive(uint64_t a, uint64_t b) { return a > b ? a : b; }
static inline int64_t saturated_s64(double x) {
  return isnan(x) ? INT64_MIN : x >= 0x1p63 ? INT64_MAX : x <= -0x1p63 ? INT64_MIN : (int64_t)x;
}
static inline int32_t saturated_s32(double x) {
  return isnan(x) ? 0 : x >= 0x1p31 ? INT32_MAX : x <= -0x1p31 ? INT32_MIN : (int32_t)x;
}

static void fail(const char* what) {
  fault = what;
  self->is_over = true;
  swapcontext(&self->context, &scheduler);
}

/* Wait for the threads of the mask, which do the same. */
static void wait_for(uint32_t mask, uint32_t kind) {
  self->mask = mask;
  self->kind = kind;
  self->is_waiting = true;
  swapcontext(&self->context, &scheduler);
}
static void meet(uint32_t mask, uint32_t kind) { wait_for(mask, kind); }
static bool any_of(uint32_t mask, bool flag) {
  self->value = flag;
  wait_for(mask, 1);
  return self->found;
}
static uint32_t of_other(uint32_t mask, uint32_t value, uint32_t distance) {
  self->value = value;
  self->distance = distance;
  wait_for(mask, 2);
  return self->found;
}

// FUNCTIONS

static void begin(void) {
  entry(given);
  self->is_over = true;
  swapcontext(&self->context, &scheduler);
}

static uint64_t draw(void) {
  state = state * 6364136223846793005ull + 1442695040888963407ull;
  return state >> 33;
}

/* Let the threads go on that one waits for, if all are there. */
static bool release(uint32_t first, uint32_t count, Thread* one) {
  Thread* group = threads + first;
  for (uint32_t lane = 0; lane < GROUP; lane++) {
    if (!(one->mask >> lane & 1)) continue;
    Thread* other = group + lane;
    if (first + lane >= count || other->is_over) { fault = "a thread has left"; return false; }
    if (!other->is_waiting) return false;
    if (other->kind != one->kind || other->mask != one->mask) {
      fault = "threads meet at different places";
      return false;
    }
  }
  if (!(one->mask >> one->lane & 1)) { fault = "a thread is not in its own mask"; return false; }
  uint32_t any = 0;
  for (uint32_t lane = 0; lane < GROUP; lane++)
    if (one->mask >> lane & 1) any |= group[lane].value;
  for (uint32_t lane = 0; lane < GROUP; lane++) {
    if (!(one->mask >> lane & 1)) continue;
    Thread* other = group + lane;
    other->found = one->kind == 2 ? group[lane ^ other->distance].value : any;
  }
  for (uint32_t lane = 0; lane < GROUP; lane++)
    if (one->mask >> lane & 1) group[lane].is_waiting = false;
  return true;
}

static void run_block(uint32_t block, uint32_t blocks, uint32_t width, uint32_t height) {
  uint32_t count = width * height;
  for (uint32_t number = 0; number < count; number++) {
    Thread* thread = threads + number;
    memset(thread, 0, sizeof *thread);
    thread->number = number;
    thread->lane = number % GROUP;
    thread->tid[0] = number % width;
    thread->tid[1] = number / width;
    thread->ntid[0] = width;
    thread->ntid[1] = height;
    thread->ntid[2] = thread->nctaid[1] = thread->nctaid[2] = 1;
    thread->ctaid[0] = block;
    thread->nctaid[0] = blocks;
    getcontext(&thread->context);
    thread->context.uc_stack.ss_sp = stacks + (size_t)number * STACK;
    thread->context.uc_stack.ss_size = STACK;
    makecontext(&thread->context, begin, 0);
  }
  for (uint32_t over = 0; over < count && fault == NULL;) {
    bool has_moved = false;
    uint32_t start = state ? draw() % count : 0, stride = state && draw() % 2 ? count - 1 : 1;
    over = 0;
    for (uint32_t step = 0; step < count && fault == NULL; step++) {
      Thread* thread = threads + (start + (uint64_t)step * stride) % count;
      if (thread->is_over) { over++; continue; }
      if (thread->is_waiting && !release(thread->number / GROUP * GROUP, count, thread)) continue;
      has_moved = true;
      self = thread;
      swapcontext(&scheduler, &thread->context);
      over += thread->is_over;
    }
    if (!has_moved && over < count && fault == NULL) fault = "threads wait for ever";
  }
}

const char* run_grid(
    uint32_t blocks, uint32_t width, uint32_t height, uint8_t* const* parameters, uint64_t order) {
  if (stacks == NULL) stacks = malloc((size_t)MOST * STACK);
  fault = NULL;
  given = parameters;
  state = order;
  for (uint32_t block = 0; block < blocks && fault == NULL; block++)
    run_block(block, blocks, width, height);
  return fault;
}

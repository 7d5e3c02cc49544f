/* A heap whose blocks stand between guards, so that a kernel that writes past its array is found: `make heap`.

   Every block has GUARD bytes of a pattern on both sides, from its very first byte to its last; they are looked at when the block
   is freed and whenever `look` is called. Warp gives room in steps of 64 bytes: elsewhere a small overrun hurts nobody, and a larger
   one shows where something else is freed. Freed blocks are overwritten, so that what reads them goes wrong. Linux, glibc. */
#include <errno.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

extern void *__libc_malloc(size_t);
extern void __libc_free(void *);
extern void *__libc_realloc(void *, size_t);

enum { GUARD = 256, BEFORE = 64, UNTOUCHED = 0xBB, FREED = 0xDD, MOST_OVERWRITTEN = 256 };
#define MARK 0x5eedf00dcafe1234UL

typedef struct Block {
    struct Block *previous, *next;
    size_t size;
    void *whole;
    unsigned char guard[BEFORE];
    uint64_t mark, own; /* blocks from before this heap have neither */
} Block;

static Block all = {.previous = &all, .next = &all};
static volatile int busy;
static int damaged;

static void enter(void) { while (__sync_lock_test_and_set(&busy, 1)); }
static void leave(void) { __sync_lock_release(&busy); }

static int is_block(void *start) {
    Block *block = (Block *)start - 1;
    return block->mark == MARK && block->own == (MARK ^ (uintptr_t)block);
}

static void check_guard(Block *block, unsigned char *guard, long count, const char *side) {
    for (long k = 0; k < count; k++)
        if (guard[k] != UNTOUCHED) {
            char text[160];
            double value;
            memcpy(&value, guard + (k & ~7L), sizeof value);
            int length = snprintf(text, sizeof text, "heap: byte %ld %s a block of %zu was written (as a double: %g)\n",
                                  side[0] == 'p' ? k : count - k, side, block->size, value);
            if (write(2, text, length) < 0) abort();
            memset(guard, UNTOUCHED, count);
            damaged++;
            return;
        }
}

static void check(Block *block) {
    check_guard(block, block->guard, BEFORE, "before");
    check_guard(block, (unsigned char *)(block + 1) + block->size, GUARD, "past");
}

/* Look at all blocks; how many were found damaged so far. */
int look(void) {
    enter();
    for (Block *block = all.next; block != &all; block = block->next) check(block);
    leave();
    return damaged;
}

static void *give(size_t alignment, size_t size) {
    if (alignment < 16) alignment = 16;
    char *whole = size > SIZE_MAX / 2 ? NULL : __libc_malloc(size + alignment + sizeof(Block) + GUARD);
    if (!whole) {
        errno = ENOMEM;
        return NULL;
    }
    char *start = (char *)(((uintptr_t)whole + sizeof(Block) + alignment - 1) & ~(alignment - 1));
    Block *block = (Block *)start - 1;
    block->size = size, block->whole = whole, block->mark = MARK, block->own = MARK ^ (uintptr_t)block;
    memset(block->guard, UNTOUCHED, BEFORE);
    memset(start + size, UNTOUCHED, GUARD);
    enter();
    block->previous = &all, block->next = all.next;
    all.next->previous = block, all.next = block;
    leave();
    return start;
}

void *malloc(size_t size) { return give(16, size); }
void *memalign(size_t alignment, size_t size) { return give(alignment, size); }
void *aligned_alloc(size_t alignment, size_t size) { return give(alignment, size); }
int posix_memalign(void **start, size_t alignment, size_t size) { return (*start = give(alignment, size)) ? 0 : ENOMEM; }
size_t malloc_usable_size(void *start) { return start && is_block(start) ? ((Block *)start - 1)->size : 0; }

void *calloc(size_t count, size_t each) {
    size_t size;
    if (__builtin_mul_overflow(count, each, &size)) size = SIZE_MAX;
    void *start = give(16, size);
    return start ? memset(start, 0, size) : NULL;
}

void free(void *start) {
    if (!start) return;
    if (!is_block(start)) {
        __libc_free(start);
        return;
    }
    Block *block = (Block *)start - 1;
    check(block);
    enter();
    block->previous->next = block->next, block->next->previous = block->previous;
    leave();
    block->mark = 0;
    memset(start, FREED, block->size < MOST_OVERWRITTEN ? block->size : MOST_OVERWRITTEN);
    __libc_free(block->whole);
}

void *realloc(void *start, size_t size) {
    if (start && !is_block(start)) return __libc_realloc(start, size);
    void *other = give(16, size);
    if (start && other) {
        size_t before = ((Block *)start - 1)->size;
        memcpy(other, start, before < size ? before : size);
        free(start);
    }
    return other;
}

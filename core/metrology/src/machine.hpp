// What makes use of a machine: wider vectors where it has them, and memory that is asked for ahead.
#pragma once

#include <cstddef>

// Of a loop that wider vectors may run, with the same bits.
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(FL_ONE_COPY)
#define FL_CLONES __attribute__((target_clones("arch=x86-64-v4", "avx2", "default")))
#else
#define FL_CLONES
#endif

namespace fl::metrology {

constexpr std::size_t line_bytes = 64;
// An image lies in no cache, and who goes through it row by row otherwise waits for each of its pages to
// begin with.
constexpr std::size_t ahead_bytes = 2048;

// Asks for what lies `ahead_bytes` behind some bytes that are read now, or written. It may lie behind the
// image.
template <int writes> inline void fetch_behind(const void *now, std::size_t bytes) {
    const char *from = static_cast<const char *>(now) + ahead_bytes;
    for (std::size_t at = 0; at < bytes; at += line_bytes) __builtin_prefetch(from + at, writes);
}

} // namespace fl::metrology

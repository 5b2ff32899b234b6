// Why a tick of the wall clock was not kept: what has taken most of the time between when it was due and the
// end of its computation.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>

namespace fl::twin {

// In the order of LateCounts and late_names.
enum class LateCause {
    woken,    // the thread slept, and was woken too late
    held,     // others touched the twin
    frames,   // frames were taken in and handed out
    taken,    // the system gave the core to others meanwhile
    blocked,  // the thread waited for a lock
    paged,    // the same as the next, and memory was touched for the first time meanwhile
    computed, // the computation itself was long
};

constexpr std::size_t late_causes = 7;
constexpr std::array<const char *, late_causes> late_names = {"woken",   "held",  "frames",  "taken",
                                                              "blocked", "paged", "computed"};
using LateCounts = std::array<uint64_t, late_causes>;

// Follows one thread that sleeps until ticks are due and computes them. All calls are of that thread.
class LateWatch {
  public:
    using Clock = std::chrono::steady_clock;

    // It goes on after a sleep, or after others have `held` the twin.
    void resumed(bool held);
    // It begins to compute: now.
    Clock::time_point begins() { return begun_ = Clock::now(); }
    struct Found {
        LateCause cause = LateCause::computed;
        bool first = false; // false: it had to wait for a tick before it, and is late for the same reason
    };
    // It has ended to compute a tick that was `due` then, too late: why. `allowed`: for the computation.
    Found late(Clock::time_point due, Clock::time_point end, Clock::duration allowed);
    // It has ended to compute a tick in time.
    void kept(Clock::time_point end) { last_end_ = end; }

  private:
    // What the thread has used so far.
    struct Usage {
        std::chrono::nanoseconds cpu{0};
        long waits = 0, faults = 0; // how often it gave the core away by itself, and touched new memory

        static Usage now();
    };
    LateCause cause_of(Clock::time_point due, Clock::time_point end, const Usage &used) const;

    Clock::time_point ready_{}, begun_{}, last_end_{};
    // when it went on, or the end of the last late tick since then, and what it had used by then
    Clock::time_point since_{};
    Usage used_{};
    bool held_ = false;
    LateCause last_ = LateCause::computed;
};

} // namespace fl::twin

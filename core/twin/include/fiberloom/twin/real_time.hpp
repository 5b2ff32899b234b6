// The twin against the wall clock: a thread of its own computes every control tick when it is due, and
// counts how late. Frames go in and out between ticks; neither side waits for the other.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <queue>
#include <thread>
#include <vector>

#include "fiberloom/twin/late_watch.hpp"
#include "fiberloom/twin/twin.hpp"

namespace fl::twin {

// How late ticks were. Tick k begins at k ticks after the start; its lateness is the time from there to the
// end of its computation. It is kept when it has ended before the next one begins.
class Lateness {
  public:
    static constexpr double bin_s = 10e-6;
    static constexpr size_t bins = 2000; // up to 20 ms; what is later counts in the last one

    // Counts so many ticks that were late_s late.
    void note(double late_s, bool kept, uint64_t ticks = 1);
    // The smallest bin edge that at least `share` of the ticks do not exceed; s.
    double quantile_s(double share) const;
    // Ticks noted.
    uint64_t ticks() const { return ticks_; }
    // Of them, kept.
    uint64_t kept() const { return kept_; }
    // The latest of them, s.
    double worst_s() const { return worst_s_; }

  private:
    std::array<uint64_t, bins> counts_{};
    uint64_t ticks_ = 0, kept_ = 0;
    double worst_s_ = 0.0;
};

// A tick that was not kept and did not have to wait for another.
struct LateTick {
    double due_s;       // by the steady clock
    double late_s;      // from there to the end of its computation
    double computing_s; // what that took
    LateCause cause;
    int core;      // of the thread; where it slept, if it was woken late; -1: the system does not tell
    size_t heard;  // frames that came with it
    size_t single; // positioners whose own firmware did the tick: they set out, turn or land
};

// How the twin keeps up with the wall clock.
struct Pace {
    Lateness busy;      // ticks in which a positioner was awake
    Lateness woken;     // by how much the thread was late, each time it had slept until a tick was due
    Lateness computing; // how long the computation of such ticks took, for each tick
    LateCounts late{};  // of the busy ticks that were not kept, by `LateCause`
    LateCounts first{}; // of them, those that did not have to wait for another one
    std::vector<LateTick> ticks; // those of `first`, one by one: the first most_late of them
    uint64_t resting = 0;        // ticks that needed no computation: every positioner rested
    double given_up_s = 0;       // wall time by which the clock was set back, because it was too far behind
};

// A frame that a bus is to carry, and the tick at which it arrives.
struct QueuedFrame {
    fl_can_frame_t frame;
    int bus;
    uint64_t tick;
};

// Runs a twin against the wall clock from its construction to stop(). The twin must outlive it, and may be
// touched only between hold() and release().
class RealTime {
  public:
    // speed: virtual seconds per second, above 0. wake_fd: gets a byte when frames wait to be taken; -1 for
    // none. first: before all ordinary programs of this machine, where the system allows it. The clock starts
    // when its thread does.
    RealTime(Twin &twin, double speed, int wake_fd, bool first = false);
    ~RealTime();
    RealTime(const RealTime &) = delete;
    RealTime &operator=(const RealTime &) = delete;

    // Frames for the buses, none before its tick nor before the next but one; those of one tick in the order
    // of their posting.
    void post(const std::vector<QueuedFrame> &frames);
    // Whether it runs before all ordinary programs of this machine.
    bool first() const { return first_; }
    // What the positioners sent since the last call.
    std::vector<Reply> take();
    // The tick that the wall clock shows now.
    double tick_now() const;
    // As of up to 20 ms ago, 70 ms while every positioner rests; and as the twin was held, within hold().
    Pace pace() const;
    // Ends the thread; the clock of the twin stops.
    void stop();
    // Between hold and release, on one thread, no tick is computed: the twin may be touched. Due ticks are
    // computed between those who hold, however many there are; one that holds may hold once more.
    void hold();
    // Lets the clock run again; as often as hold() was called.
    void release();

  private:
    using Clock = std::chrono::steady_clock;
    struct Posted {
        QueuedFrame queued;
        uint64_t order;
        bool operator>(const Posted &b) const {
            return queued.tick != b.queued.tick ? queued.tick > b.queued.tick : order > b.order;
        }
    };
    void begin(bool first);
    void loop();
    void nap();
    void park();
    void exchange(std::unique_lock<std::mutex> lock);
    void compute(uint64_t ticks);
    void deliver();
    void give_up();
    void note(uint64_t first, uint64_t ticks, Clock::time_point begin, Clock::time_point end);
    void rest();
    void publish();
    bool called() const { return stop_ || holders_ > 0; }
    uint64_t ticks_begun() const;
    uint64_t ticks_due() const;
    uint64_t idle_ticks(uint64_t ticks) const;
    Clock::time_point due(uint64_t tick) const;

    Twin &twin_;
    const std::chrono::duration<double> tick_;
    const int wake_fd_;
    std::atomic<Clock::time_point> start_; // of tick 0; moves when time is given up
    bool first_ = false;                   // written before the clock starts
    bool begun_ = false;                   // likewise, under the mutex
    std::atomic<bool> stop_{false};
    std::atomic<int> holders_{0};

    // the thread's own: another thread that the system has stopped never keeps it waiting
    std::priority_queue<Posted, std::vector<Posted>, std::greater<>> agenda_;
    std::vector<Reply> sent_;
    Pace pace_;
    LateWatch watch_;
    Clock::time_point told_{}; // when pace_ was published
    int slept_on_ = -1;        // the core whose timer was to wake it
    size_t heard_ = 0;         // frames handed out since the last tick

    // what it shares, and looks at only when no other thread does
    mutable std::mutex mutex_;
    std::condition_variable change_;
    std::vector<std::thread::id> within_; // who holds; as often as it does
    int inside_ = 0;                      // of the holders those for whom the clock stands now
    uint64_t parks_ = 0;                  // how often it has stood
    bool ended_ = false;                  // it stands for good
    uint64_t posted_ = 0;
    std::vector<Posted> inbox_;
    std::vector<Reply> outbox_;
    Pace published_;

    std::thread thread_;
};

} // namespace fl::twin

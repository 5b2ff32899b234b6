#include "fiberloom/twin/late_watch.hpp"

#include <algorithm>
#include <ctime>
#include <sys/resource.h>

namespace fl::twin {

LateWatch::Usage LateWatch::Usage::now() {
    Usage found;
    timespec cpu{};
    if (clock_gettime(CLOCK_THREAD_CPUTIME_ID, &cpu) == 0)
        found.cpu = std::chrono::seconds(cpu.tv_sec) + std::chrono::nanoseconds(cpu.tv_nsec);
#ifdef RUSAGE_THREAD
    rusage usage{};
    if (getrusage(RUSAGE_THREAD, &usage) == 0) {
        found.waits = usage.ru_nvcsw;
        found.faults = usage.ru_minflt + usage.ru_majflt;
    }
#endif
    return found;
}

void LateWatch::resumed(bool held) {
    ready_ = since_ = Clock::now();
    used_ = Usage::now();
    held_ = held;
}

LateWatch::Found LateWatch::late(Clock::time_point due, Clock::time_point end, Clock::duration allowed) {
    // who goes on without a sleep works on what a late tick has left; if that takes too long too, it would be
    // late anyway
    const bool first = ready_ > last_end_ || last_end_ <= due || end - begun_ > allowed;
    const Usage used = Usage::now();
    if (first) last_ = cause_of(std::max(due, std::min(last_end_, begun_)), end, used);
    // what came between is told of this tick: those that follow without a sleep begin anew
    since_ = last_end_ = end;
    used_ = used;
    return {last_, first};
}

LateCause LateWatch::cause_of(Clock::time_point due, Clock::time_point end, const Usage &used) const {
    const auto begun = std::max(begun_, due), ready = std::clamp(ready_, due, begun);
    const auto woken = ready - due, frames = begun - ready, computed = end - begun;
    // since_ may be before the tick was due: the thread has not slept in between
    const auto away =
        std::max<Clock::duration>((end - since_) - (used.cpu - used_.cpu), Clock::duration::zero());
    const auto longest = std::max({woken, frames, computed});
    if (woken == longest) return held_ ? LateCause::held : LateCause::woken;
    if (2 * away > longest) return used.waits > used_.waits ? LateCause::blocked : LateCause::taken;
    if (used.faults > used_.faults) return LateCause::paged;
    return frames == longest ? LateCause::frames : LateCause::computed;
}

} // namespace fl::twin

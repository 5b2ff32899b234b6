#include "fiberloom/twin/real_time.hpp"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <ctime>
#include <pthread.h>
#include <sched.h>
#include <unistd.h>
#ifdef __linux__
#include <sys/prctl.h>
#include <sys/syscall.h>
#endif
#include <utility>

namespace fl::twin {
namespace {

constexpr double patience_s = 1.0;                    // further behind than this, time is given up
constexpr std::chrono::milliseconds nap_time{50};     // while every positioner rests
constexpr std::chrono::milliseconds telling_time{20}; // between two copies of the figures for others
constexpr size_t most_late = 200;                     // late ticks that are told one by one
constexpr uint64_t most_ticks = std::max<uint64_t>(4, sync_ticks); // of one go, when behind

// Of this thread, as far as the system goes along: short turns, so that it is let in when it wakes up and
// need not wait for the turns of others to end (Linux 6.12, which keeps policy and nice), and timers that
// ring in time.
void ask_for_short_turns() {
#ifdef SYS_sched_setattr
    struct {
        uint32_t size, policy;
        uint64_t flags;
        int32_t nice;
        uint32_t priority;
        uint64_t runtime_ns, deadline_ns, period_ns;
    } turns{};
    if (syscall(SYS_sched_getattr, 0, &turns, sizeof turns, 0) == 0 && turns.policy == SCHED_OTHER) {
        turns.size = sizeof turns;
        turns.runtime_ns = 100000; // the shortest there are
        syscall(SYS_sched_setattr, 0, &turns, 0);
    }
    prctl(PR_SET_TIMERSLACK, 1UL);
#endif
}

// This thread, before all ordinary programs; false where the system does not allow it.
bool goes_first() {
    sched_param low{};
    low.sched_priority =
        sched_get_priority_min(SCHED_FIFO) + 1; // the rest of this program may have the lowest
    return pthread_setschedparam(pthread_self(), SCHED_FIFO, &low) == 0;
}

// Where this thread runs.
int core_now() {
#ifdef __linux__
    return sched_getcpu();
#else
    return -1;
#endif
}

// To a moment, not for a time: what passes before it sleeps makes it no later.
void sleep_until(std::chrono::steady_clock::time_point when) {
#ifdef __linux__
    const auto since = when.time_since_epoch();
    const auto whole = std::chrono::duration_cast<std::chrono::seconds>(since);
    const auto rest = std::chrono::duration_cast<std::chrono::nanoseconds>(since - whole);
    const timespec until{static_cast<time_t>(whole.count()), static_cast<long>(rest.count())};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {}
#else
    std::this_thread::sleep_until(when);
#endif
}

} // namespace

void Lateness::note(double late_s, bool kept, uint64_t ticks) {
    const double bin = std::clamp(std::ceil(late_s / bin_s) - 1.0, 0.0, static_cast<double>(bins - 1));
    counts_[static_cast<size_t>(bin)] += ticks;
    ticks_ += ticks;
    if (kept) kept_ += ticks;
    worst_s_ = std::max(worst_s_, late_s);
}

double Lateness::quantile_s(double share) const {
    const double wanted = share * static_cast<double>(ticks_);
    uint64_t sum = 0;
    for (size_t i = 0; i + 1 < bins; ++i) {
        sum += counts_[i];
        if (static_cast<double>(sum) >= wanted) return std::min(static_cast<double>(i + 1) * bin_s, worst_s_);
    }
    return worst_s_;
}

RealTime::RealTime(Twin &twin, double speed, int wake_fd, bool first)
    : twin_(twin), tick_(tick_s / speed), wake_fd_(wake_fd) {
    pace_.ticks.reserve(most_late);
    thread_ = std::thread([this, first] {
        begin(first);
        loop();
    });
    std::unique_lock lock(mutex_);
    change_.wait(lock, [this] { return begun_; });
}

// Not before it has its priority: until then others may keep it from the core.
void RealTime::begin(bool first) {
    ask_for_short_turns();
    first_ = first && goes_first();
    const auto past = static_cast<double>(twin_.tick()) * tick_;
    const std::lock_guard lock(mutex_);
    start_ = Clock::now() - std::chrono::duration_cast<Clock::duration>(past);
    begun_ = true;
    change_.notify_all();
}

RealTime::~RealTime() { stop(); }

void RealTime::stop() {
    {
        const std::lock_guard lock(mutex_);
        stop_ = true;
    }
    change_.notify_all();
    if (thread_.joinable()) thread_.join();
}

RealTime::Clock::time_point RealTime::due(uint64_t tick) const {
    return start_.load() + std::chrono::duration_cast<Clock::duration>(static_cast<double>(tick) * tick_);
}

double RealTime::tick_now() const { return (Clock::now() - start_.load()) / tick_; }

// By the wall clock: also the number of the tick that begins next.
uint64_t RealTime::ticks_begun() const { return static_cast<uint64_t>(std::max(tick_now(), 0.0)) + 1; }

// Ticks that have begun and are not computed.
uint64_t RealTime::ticks_due() const {
    const uint64_t begun = ticks_begun();
    return begun > twin_.tick() ? begun - twin_.tick() : 0;
}

// Of so many ticks, those in which nothing happens.
uint64_t RealTime::idle_ticks(uint64_t ticks) const {
    if (!twin_.resting()) return 0;
    if (agenda_.empty()) return ticks;
    const uint64_t first = agenda_.top().queued.tick;
    return first > twin_.tick() ? std::min(ticks, first - twin_.tick()) : 0;
}

void RealTime::post(const std::vector<QueuedFrame> &frames) {
    {
        const std::lock_guard lock(mutex_);
        // not the tick that begins next: so there is time to hand out what 500 positioners hear at once
        const uint64_t next = ticks_begun() + 1;
        for (QueuedFrame queued : frames) {
            queued.tick = std::max(queued.tick, next);
            inbox_.push_back({queued, posted_++});
        }
    }
    change_.notify_all();
}

std::vector<Reply> RealTime::take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(outbox_, {});
}

Pace RealTime::pace() const {
    const std::lock_guard lock(mutex_);
    return published_;
}

void RealTime::hold() {
    std::unique_lock lock(mutex_);
    const std::thread::id me = std::this_thread::get_id();
    ++holders_;
    if (std::find(within_.begin(), within_.end(), me) != within_.end()) { // once more: the clock stands
        ++inside_;
        within_.push_back(me);
        return;
    }
    change_.notify_all();
    // one that comes while others hold waits for the next stop of the clock: else those who look in turn, and
    // overlap, would keep it from running at all
    change_.wait(lock, [this, before = parks_] { return parks_ != before || ended_; });
    within_.push_back(me);
}

void RealTime::release() {
    {
        const std::lock_guard lock(mutex_);
        --holders_;
        if (inside_ > 0) --inside_;
        const auto mine = std::find(within_.begin(), within_.end(), std::this_thread::get_id());
        if (mine != within_.end()) within_.erase(mine);
    }
    change_.notify_all();
}

// What has been posted comes in, what was sent goes out.
void RealTime::exchange(std::unique_lock<std::mutex> lock) {
    if (!lock.owns_lock()) return; // next time
    for (const Posted &posted : inbox_) agenda_.push(posted);
    inbox_.clear();
    outbox_.insert(outbox_.end(), sent_.begin(), sent_.end());
    const bool news = !sent_.empty();
    sent_.clear();
    if (Clock::now() - told_ > telling_time) publish();
    lock.unlock();
    const char byte = 0;
    // a full pipe has woken the taker already
    if (news && wake_fd_ >= 0 && write(wake_fd_, &byte, 1) < 0) return;
}

// Others see the figures as they are now. The mutex is held.
void RealTime::publish() {
    published_ = pace_;
    told_ = Clock::now();
}

void RealTime::deliver() {
    while (!agenda_.empty() && agenda_.top().queued.tick <= twin_.tick()) {
        twin_.send(agenda_.top().queued.frame, agenda_.top().queued.bus);
        agenda_.pop();
        ++heard_;
    }
    twin_.prepare();
}

// A machine that slept or was taken away for long: that time is not made up for.
void RealTime::give_up() {
    const std::chrono::duration<double> behind = Clock::now() - due(twin_.tick());
    if (behind.count() <= patience_s) return;
    pace_.given_up_s += behind.count();
    start_ = start_.load() + std::chrono::duration_cast<Clock::duration>(behind);
}

void RealTime::compute(uint64_t ticks) {
    const uint64_t first = twin_.tick();
    const bool awake = !twin_.resting();
    const Clock::time_point begin = watch_.begins();
    const std::vector<Reply> replies = twin_.run(ticks);
    const Clock::time_point end = Clock::now();
    if (awake)
        note(first, ticks, begin, end);
    else
        pace_.resting += ticks;
    heard_ = 0;
    sent_.insert(sent_.end(), replies.begin(), replies.end());
}

// Counts so many ticks from `first` on that were computed at once, and why they are late if they are.
void RealTime::note(uint64_t first, uint64_t ticks, Clock::time_point begin, Clock::time_point end) {
    const std::chrono::duration<double> each = (end - begin) / static_cast<double>(ticks);
    pace_.computing.note(each.count(), each <= tick_, ticks);
    const bool all = end <= due(first + 1);
    LateWatch::Found why{};
    if (all)
        watch_.kept(end);
    else
        why = watch_.late(due(first), end, due(first + ticks) - due(first));
    pace_.first[static_cast<size_t>(why.cause)] += why.first;
    const auto seconds = [](Clock::duration time) { return std::chrono::duration<double>(time).count(); };
    if (why.first && pace_.ticks.size() < most_late)
        pace_.ticks.push_back(
            {seconds(due(first).time_since_epoch()), seconds(end - due(first)), each.count(), why.cause,
             why.cause == LateCause::woken ? slept_on_ : core_now(), heard_, twin_.single_ticks()});
    for (uint64_t tick = first; tick < first + ticks; ++tick) {
        const bool kept = end <= due(tick + 1);
        pace_.busy.note(std::chrono::duration<double>(end - due(tick)).count(), kept);
        if (!kept) ++pace_.late[static_cast<size_t>(why.cause)];
    }
}

// Until the next tick is due. What comes with it is taken in before: afterwards there would be less time.
void RealTime::rest() {
    deliver();
    const Clock::time_point next = due(twin_.tick());
    if (Clock::now() >= next) return;
    slept_on_ = core_now();
    sleep_until(next);
    watch_.resumed(false);
    if (!twin_.resting()) pace_.woken.note(std::chrono::duration<double>(Clock::now() - next).count(), true);
}

// While nothing moves and nothing comes there is no need to look at the clock.
void RealTime::nap() {
    std::unique_lock lock(mutex_);
    change_.wait_for(lock, nap_time, [this] { return called() || !inbox_.empty(); });
    lock.unlock();
    watch_.resumed(false);
}

// Others touch the twin.
void RealTime::park() {
    std::unique_lock lock(mutex_);
    inside_ = holders_;
    ++parks_;
    publish();
    change_.notify_all();
    change_.wait(lock, [this] { return stop_ || inside_ == 0; });
    lock.unlock();
    watch_.resumed(true);
}

void RealTime::loop() {
    while (!stop_) {
        if (holders_ > 0) park();
        exchange(std::unique_lock(mutex_, std::try_to_lock));
        if (agenda_.empty() && sent_.empty() && twin_.resting()) nap();
        if (stop_) continue;
        exchange(std::unique_lock(mutex_, std::try_to_lock));
        give_up();
        const uint64_t ticks = ticks_due(), idle = idle_ticks(ticks);
        if (ticks == 0) {
            if (!called()) rest();
            continue;
        }
        if (idle == 0) deliver();
        compute(idle > 0 ? idle : std::min(ticks, agenda_.empty() ? most_ticks : 1));
    }
    exchange(std::unique_lock(mutex_));
    {
        const std::lock_guard lock(mutex_);
        publish();
        ended_ = true; // not before: the last tick may have been under way when the clock was stopped
    }
    change_.notify_all();
}

} // namespace fl::twin

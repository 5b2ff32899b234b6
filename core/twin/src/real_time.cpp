#include "fiberloom/twin/real_time.hpp"

#include <algorithm>
#include <cmath>
#include <unistd.h>
#include <utility>

namespace fl::twin {
namespace {

constexpr double patience_s = 1.0;           // further behind than this, time is given up
constexpr std::chrono::milliseconds nap{50}; // while everybody rests
constexpr uint64_t most_ticks = std::max<uint64_t>(4, sync_ticks); // of one go, when behind

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

RealTime::RealTime(Twin &twin, double speed, int wake_fd)
    : twin_(twin), tick_(tick_s / speed), wake_fd_(wake_fd) {
    start_ =
        Clock::now() - std::chrono::duration_cast<Clock::duration>(static_cast<double>(twin.tick()) * tick_);
    thread_ = std::thread([this] { loop(); });
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
    return start_ + std::chrono::duration_cast<Clock::duration>(static_cast<double>(tick) * tick_);
}

double RealTime::tick_now() const {
    const std::lock_guard lock(mutex_);
    return std::chrono::duration<double>(Clock::now() - start_) / tick_;
}

// Ticks that have begun by the wall clock and are not computed.
uint64_t RealTime::ticks_due() const {
    const double begun = std::floor(std::chrono::duration<double>(Clock::now() - start_) / tick_) + 1.0;
    const double left = begun - static_cast<double>(twin_.tick());
    return left > 0.0 ? static_cast<uint64_t>(left) : 0;
}

void RealTime::post(const std::vector<Errand> &errands) {
    {
        const std::lock_guard lock(mutex_);
        for (const Errand &errand : errands) inbox_.push({errand, posted_++});
    }
    change_.notify_all();
}

std::vector<Reply> RealTime::take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(outbox_, {});
}

Pace RealTime::pace() const {
    const std::lock_guard lock(mutex_);
    return pace_;
}

void RealTime::hold() {
    std::unique_lock lock(mutex_);
    ++holders_;
    change_.wait(lock, [this] { return !computing_; });
}

void RealTime::release() {
    {
        const std::lock_guard lock(mutex_);
        --holders_;
    }
    change_.notify_all();
}

void RealTime::wake_taker() {
    const char byte = 0;
    // a full pipe has woken the taker already
    if (wake_fd_ >= 0 && write(wake_fd_, &byte, 1) < 0) return;
}

void RealTime::deliver() {
    while (!inbox_.empty() && inbox_.top().errand.tick <= twin_.tick()) {
        twin_.send(inbox_.top().errand.frame, inbox_.top().errand.bus);
        inbox_.pop();
    }
}

// A machine that slept or was taken away for long: nobody wants that time played fast forward.
void RealTime::catch_up_or_give_up() {
    const std::chrono::duration<double> behind = Clock::now() - due(twin_.tick());
    if (behind.count() <= patience_s) return;
    pace_.given_up_s += behind.count();
    start_ += std::chrono::duration_cast<Clock::duration>(behind);
}

void RealTime::compute(std::unique_lock<std::mutex> &lock, uint64_t ticks) {
    const uint64_t first = twin_.tick();
    const bool awake = !twin_.resting();
    computing_ = true;
    lock.unlock();
    std::vector<Reply> replies = twin_.run(ticks);
    const Clock::time_point end = Clock::now();
    lock.lock();
    computing_ = false;
    if (holders_ > 0) change_.notify_all();
    if (!awake) pace_.resting += ticks;
    for (uint64_t tick = first; awake && tick < first + ticks; ++tick)
        pace_.busy.note(std::chrono::duration<double>(end - due(tick)).count(), end <= due(tick + 1));
    if (replies.empty()) return;
    outbox_.insert(outbox_.end(), replies.begin(), replies.end());
    wake_taker();
}

// True when nobody moved and nothing came: time is made up for without computing it.
bool RealTime::rest(std::unique_lock<std::mutex> &lock) {
    if (!twin_.resting()) return false;
    const auto something = [this] { return stop_ || holders_ > 0 || !inbox_.empty(); };
    return !change_.wait_for(lock, nap, something);
}

void RealTime::loop() {
    std::unique_lock lock(mutex_);
    while (!stop_) {
        change_.wait(lock, [this] { return stop_ || holders_ == 0; });
        rest(lock);
        if (stop_ || holders_ > 0) continue;
        catch_up_or_give_up();
        const bool resting = twin_.resting();
        uint64_t ticks = ticks_due();
        if (ticks == 0) {
            const Clock::time_point next = due(twin_.tick());
            lock.unlock();
            std::this_thread::sleep_until(next);
            lock.lock();
            continue;
        }
        // while everybody rests, up to the present at once: what came, came now
        if (resting && ticks > 1) {
            compute(lock, ticks - 1);
            if (holders_ > 0) continue;
            ticks = 1;
        }
        deliver();
        compute(lock, std::min(ticks, inbox_.empty() ? most_ticks : 1));
    }
}

} // namespace fl::twin

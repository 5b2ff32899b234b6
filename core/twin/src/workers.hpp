// Threads that wait for a batch of tasks, so that a batch of microseconds is worth sharing out.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <thread>
#include <vector>

namespace fl::twin {

// A batch has tasks 0 to count - 1. A helper that sleeps through a batch delays none: the threads that are
// awake take the tasks, and the batch ends with the last task.
class Workers {
  public:
    // threads: in all, the calling one included.
    Workers(int threads, std::function<void(size_t)> task) : task_(std::move(task)) {
        for (int i = 1; i < threads; ++i) helpers_.emplace_back([this] { help(); });
    }
    ~Workers() {
        closing_ = true;
        call();
        for (std::thread &t : helpers_) t.join();
    }
    Workers(const Workers &) = delete;
    Workers &operator=(const Workers &) = delete;

    // Does every one of `count` tasks once, in any order, and returns when all are done.
    // @pre count < 2^32
    void run(size_t count) {
        done_ = 0;
        tickets_ = Tickets{count} << 32; // from here on tasks may be taken
        if (!helpers_.empty() && count > 1) call();
        take_tasks();
        for (size_t done = done_; done != count; done = done_) done_.wait(done);
    }

  private:
    // The number of tasks above, the next of them below: one that is late sees that its batch is over.
    using Tickets = uint64_t;

    void call() {
        batch_.fetch_add(1);
        batch_.notify_all();
    }
    void take_tasks() {
        for (Tickets t = tickets_.fetch_add(1); static_cast<uint32_t>(t) < t >> 32;
             t = tickets_.fetch_add(1)) {
            task_(static_cast<uint32_t>(t));
            if (done_.fetch_add(1) + 1 == t >> 32) done_.notify_all();
        }
    }
    void help() {
        for (unsigned seen = 0; !closing_; seen = batch_) {
            take_tasks();
            batch_.wait(seen);
        }
    }

    const std::function<void(size_t)> task_;
    std::vector<std::thread> helpers_;
    std::atomic<Tickets> tickets_{0};
    std::atomic<size_t> done_{0};
    std::atomic<unsigned> batch_{0};
    std::atomic<bool> closing_{false};
};

} // namespace fl::twin

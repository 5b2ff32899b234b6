// Threads that wait for a batch of tasks, so that a batch of microseconds is worth sharing out.
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <thread>
#include <vector>

namespace fl::twin {

// Every batch has the same tasks, 0 to count - 1. A helper that sleeps through a batch delays
// none: the threads that are awake take the tasks, and the batch ends with the last task.
class Workers {
  public:
    // threads: in all, the calling one included.
    Workers(int threads, size_t count, std::function<void(size_t)> task)
        : task_(std::move(task)), count_(count), next_(count) {
        for (int i = 1; i < threads; ++i) helpers_.emplace_back([this] { help(); });
    }
    ~Workers() {
        closing_ = true;
        call();
        for (std::thread &t : helpers_) t.join();
    }
    Workers(const Workers &) = delete;
    Workers &operator=(const Workers &) = delete;

    // Does every task once, in any order, and returns when all are done.
    void run() {
        done_ = 0;
        next_ = 0; // from here on tasks may be taken
        if (!helpers_.empty()) call();
        take_tasks();
        for (size_t done = done_; done != count_; done = done_) done_.wait(done);
    }

  private:
    void call() {
        batch_.fetch_add(1);
        batch_.notify_all();
    }
    void take_tasks() {
        for (size_t i = next_.fetch_add(1); i < count_; i = next_.fetch_add(1)) {
            task_(i);
            if (done_.fetch_add(1) + 1 == count_) done_.notify_all();
        }
    }
    void help() {
        for (unsigned seen = 0; !closing_; seen = batch_) {
            take_tasks();
            batch_.wait(seen);
        }
    }

    const std::function<void(size_t)> task_;
    const size_t count_;
    std::vector<std::thread> helpers_;
    std::atomic<size_t> next_, done_{0};
    std::atomic<unsigned> batch_{0};
    std::atomic<bool> closing_{false};
};

} // namespace fl::twin

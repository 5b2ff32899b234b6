// Threads that wait for a batch of tasks, so that a batch of microseconds is worth sharing out.
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <thread>
#include <vector>

namespace fl::twin {

class Workers {
  public:
    // threads: in all, the calling one included.
    explicit Workers(int threads) {
        for (int i = 1; i < threads; ++i) helpers_.emplace_back([this] { help(); });
    }
    ~Workers() {
        closing_ = true;
        start_batch();
        for (std::thread &t : helpers_) t.join();
    }
    Workers(const Workers &) = delete;
    Workers &operator=(const Workers &) = delete;

    // Calls task(0) to task(count - 1), each once, in any order, and returns when all are done.
    void run(size_t count, const std::function<void(size_t)> &task) {
        task_ = &task;
        count_ = count;
        next_ = 0;
        busy_ = static_cast<int>(helpers_.size());
        start_batch();
        take_tasks();
        for (int left = busy_; left != 0; left = busy_) busy_.wait(left);
    }

  private:
    void start_batch() {
        batch_.fetch_add(1);
        batch_.notify_all();
    }
    void take_tasks() {
        for (size_t i = next_.fetch_add(1); i < count_; i = next_.fetch_add(1)) (*task_)(i);
    }
    void help() {
        for (unsigned seen = 0;;) {
            batch_.wait(seen);
            seen = batch_.load();
            if (closing_) return;
            take_tasks();
            if (busy_.fetch_sub(1) == 1) busy_.notify_one();
        }
    }

    std::vector<std::thread> helpers_;
    const std::function<void(size_t)> *task_ = nullptr;
    size_t count_ = 0;
    std::atomic<size_t> next_{0};
    std::atomic<int> busy_{0};
    std::atomic<unsigned> batch_{0};
    std::atomic<bool> closing_{false};
};

} // namespace fl::twin

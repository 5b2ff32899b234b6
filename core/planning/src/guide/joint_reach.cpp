#include "guide/joint_reach.hpp"

#include <algorithm>
#include <utility>

namespace fl::planning {
namespace {

constexpr int word_bits = 64, blocks_per_word = word_bits / BlockedCells::block;
constexpr double table_error_mm = 0.2; // of the touch table

Cell moved_by(Cell c, int move) { return {c.alpha + move % 3 - 1, c.beta + move / 3 - 1}; }

int words_of_line(const Robot &robot) { return (robot.alpha().size() + word_bits - 1) / word_bits; }

} // namespace

JointReach::Places JointReach::places_of(const Robot &robot) {
    Places out{{}, List<int>(robot.cells(), -1)};
    const auto put = [&](Cell c) {
        if (!robot.inside(c) || out.of[robot.index(c)] >= 0 || !robot.may_be_at(c)) return;
        out.of[robot.index(c)] = out.cells.size();
        out.cells.push_back(c);
    };
    put(robot.start());
    put(robot.goal());
    for (int k = 0; k < out.cells.size(); ++k)
        for (int move = 0; move < 9; ++move) put(moved_by(out.cells[k], move));
    return out;
}

std::int64_t JointReach::words(const Robot &first, const Robot &second) {
    return static_cast<std::int64_t>(places_of(first).cells.size()) * second.beta().size() *
           words_of_line(second);
}

int JointReach::word(Cell second) const { return second.beta * width_ + second.alpha / word_bits; }

// The cells of the second one that are open when the first is at one of its own.
const JointReach::Word *JointReach::open(int place) {
    Word *out = open_.data() + place * size();
    if (std::exchange(known_[place], std::uint8_t{1}) != 0) return out;
    std::copy_n(alone_.data(), size(), out);
    const int blocks = BlockedCells::blocks_per_line(*second_);
    const BlockedLines shut = blocked_.by(*second_, 0, *first_, places_.cells[place], need_mm_, tables_);
    for (int beta = shut.first; beta < shut.end; ++beta)
        for (int k = 0; k < blocks; ++k) {
            const Word bits = shut.bits[(beta - shut.first) * blocks + k];
            out[beta * width_ + k / blocks_per_word] &= ~(bits << k % blocks_per_word * BlockedCells::block);
        }
    return out;
}

// Of a line and those beside it in it, what is within; whether that is more than was known.
bool JointReach::add_line(const Word *from, const Word *within, Word *to) const {
    Word more = 0;
    for (int k = 0; k < width_; ++k) {
        Word word = from[k] | from[k] << 1 | from[k] >> 1;
        if (k > 0) word |= from[k - 1] >> (word_bits - 1);
        if (k + 1 < width_) word |= from[k + 1] << (word_bits - 1);
        word &= within[k] & ~to[k];
        more |= word;
        to[k] |= word;
    }
    return more != 0;
}

// From cells of the second one to all around them.
bool JointReach::add_around(const Word *from, const Word *within, Word *to) const {
    bool any = false;
    for (int beta = 0; beta < betas_; ++beta)
        for (int near = std::max(beta - 1, 0); near <= std::min(beta + 1, betas_ - 1); ++near)
            any |= add_line(from + near * width_, within + beta * width_, to + beta * width_);
    return any;
}

// All that the second one can come to while the first rests: up and down its lines until that is all.
void JointReach::fill(const Word *within, Word *to) const {
    const auto spread = [&](int from, int beta) {
        bool any = add_line(to + from * width_, within + beta * width_, to + beta * width_);
        while (add_line(to + beta * width_, within + beta * width_, to + beta * width_)) any = true;
        return any;
    };
    for (bool more = true; more;) {
        more = false;
        for (int beta = 0; beta < betas_; ++beta) more |= spread(std::max(beta - 1, 0), beta);
        for (int beta = betas_ - 2; beta >= 0; --beta) more |= spread(beta + 1, beta);
    }
}

void JointReach::put_around(Flood &flood, Cell here) {
    for (int move = 0; move < 9; ++move) {
        const int at = move == 4 ? -1 : place(moved_by(here, move));
        if (at < 0 || std::exchange(flood.queued[at], std::uint8_t{1}) != 0) continue;
        flood.queue.push_back(at);
    }
}

void JointReach::begin(Flood &flood, Cell first, Cell second) {
    flood = {};
    flood.reached.assign(places_.cells.size() * size(), 0);
    flood.queued.assign(places_.cells.size(), 0);
    const int at = place(first);
    const Word *within = open(at);
    Word *mine = reached(flood, at);
    mine[word(second)] = within[word(second)] & Word{1} << second.alpha % word_bits;
    fill(within, mine);
    put_around(flood, first);
}

void JointReach::meet(int place) {
    const Word *one = reached(floods_[0], place), *other = reached(floods_[1], place);
    for (int k = 0; k < size(); ++k) met_ |= (one[k] & other[k]) != 0;
}

// Where the first one is next: what the second can come to from where both were beside it.
void JointReach::grow(Flood &flood) {
    const int at = flood.queue[flood.next++];
    flood.queued[at] = 0;
    const Cell here = places_.cells[at];
    std::fill(around_.begin(), around_.end(), 0);
    for (int move = 0; move < 9; ++move) {
        const int from = place(moved_by(here, move));
        if (from < 0) continue;
        const Word *near = reached(flood, from);
        for (int k = 0; k < size(); ++k) around_[k] |= near[k];
    }
    Word *mine = reached(flood, at);
    const Word *within = open(at);
    if (!add_around(around_.data(), within, mine)) return;
    fill(within, mine);
    meet(at);
    put_around(flood, here);
}

void JointReach::begin(const Robot &first, const Robot &second, double need_mm) {
    first_ = &first;
    second_ = &second;
    need_mm_ = need_mm - first.widest_displacement_mm() - second.widest_displacement_mm() - table_error_mm;
    met_ = false;
    blocked_ = {};
    places_ = places_of(first);
    betas_ = second.beta().size();
    width_ = words_of_line(second);
    alone_.assign(size(), 0);
    for (const Cell c : places_of(second).cells) alone_[word(c)] |= Word{1} << c.alpha % word_bits;
    around_.assign(size(), 0);
    open_.resize(places_.cells.size() * size());
    known_.assign(places_.cells.size(), 0);
    begin(floods_[0], first.start(), second.start());
    begin(floods_[1], first.goal(), second.goal());
    for (const Cell end : {first.start(), first.goal()}) meet(place(end));
}

bool JointReach::none(const Robot &first, const Robot &second, double need_mm) {
    for (const Robot *one : {&first, &second})
        if (!one->may_be_at(one->start()) || !one->may_be_at(one->goal())) return false;
    begin(first, second, need_mm);
    for (int turn = 0; !met_; turn = 1 - turn) {
        if (floods_[turn].ended()) return true;
        grow(floods_[turn]);
    }
    return false;
}

} // namespace fl::planning

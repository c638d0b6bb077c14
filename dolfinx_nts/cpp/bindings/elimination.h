#pragma once

#include "array.h"
#include "nts/solvers/elimination.h"

namespace nts::bindings
{
/// @brief `Elimination` and the arrays that it reads, which determine the
/// number of components.
class BoundElimination
{
public:
  BoundElimination(In<std::int64_t> start, In<std::int32_t> nodes,
                   In<std::int32_t> rank, Doubles normal, Doubles gradients,
                   Doubles columns, Doubles slopes,
                   In<std::int32_t> tangent_nodes, Doubles tangent)
      : _start(std::move(start)), _nodes(std::move(nodes)),
        _rank(std::move(rank)), _normal(std::move(normal)),
        _gradients(std::move(gradients)), _columns(std::move(columns)),
        _slopes(std::move(slopes)), _tangent_nodes(std::move(tangent_nodes)),
        _tangent(std::move(tangent))
  {
    const std::size_t m = _rank.size();
    check("rank", _rank, {m});
    check("start", _start, {m + 1});
    check("normal", _normal, {m, any});
    const std::size_t B = components();
    dispatch_components(B, []<std::size_t>() {});
    check("slopes", _slopes, {m, B, B});
    check("tangent_nodes", _tangent_nodes, {any, any});
    const std::size_t n = B * _tangent_nodes.shape(1);
    check("tangent", _tangent, {_tangent_nodes.shape(0), n, n});
    for (const Doubles* rows : {&_gradients, &_columns})
      if (rows->size() != B * B * _nodes.size())
        throw nb::value_error(
            "gradients and columns: expected a block for each entry of nodes");
    const auto begin = view(_start);
    if (begin.front() != 0 || begin.back() != std::ssize(view(_nodes))
        || std::ranges::adjacent_find(begin, std::greater_equal<>())
               != begin.end())
      throw nb::value_error("start: expected strictly ascending offsets, from "
                            "0 to the length of nodes");
    for (const std::int32_t rank : view(_rank))
      if (rank != 0 && rank != 1 && rank != static_cast<std::int32_t>(B))
        throw nb::value_error(
            "rank: expected 0, 1 or the number of components");
    for (const In<std::int32_t>* nodes : {&_nodes, &_tangent_nodes})
      for (const std::int32_t node : view(*nodes))
      {
        if (node < 0)
          throw nb::value_error("nodes: expected no negative entry");
        _num_nodes = std::max(_num_nodes, static_cast<std::size_t>(node) + 1);
      }
  }

  /// @brief Components of a node.
  std::size_t components() const noexcept { return _normal.shape(1); }

  template <std::size_t B>
  Elimination<B> get() const noexcept
  {
    return {.start = view(_start),
            .nodes = view(_nodes),
            .rank = view(_rank),
            .normal = view(_normal),
            .gradients = view(_gradients),
            .columns = view(_columns),
            .slopes = view(_slopes),
            .width = _tangent_nodes.shape(1),
            .tangent_nodes = view(_tangent_nodes),
            .tangent = view(_tangent)};
  }

  void constrain(const Doubles& values, Out<double> x, Out<double> ghosts) const
  {
    check_values(values);
    check_rows("x", x, ghosts);
    dispatch_components(components(),
                        [&]<std::size_t B>()
                        {
                          nts::constrain(get<B>(), view(values),
                                         ChangedValues{view(x), view(ghosts)});
                        });
  }

  auto missing(const Doubles& values, const Doubles& x,
               const Doubles& ghosts) const
  {
    check_values(values);
    check_rows("x", x, ghosts);
    auto result = create<double>({_rank.size(), components()});
    dispatch_components(components(),
                        [&]<std::size_t B>()
                        {
                          const KnownValues known{view(x), view(ghosts)};
                          for (std::size_t i = 0; i < _rank.size(); ++i)
                            std::ranges::copy(
                                nts::missing(get<B>(), i, view(values), known),
                                result.data() + B * i);
                        });
    return result;
  }

  void remove(const Doubles& multipliers, Out<double> y,
              Out<double> ghosts) const
  {
    check_rows("y", y, ghosts);
    check("multipliers", multipliers, {_rank.size(), components()});
    dispatch_components(components(),
                        [&]<std::size_t B>()
                        {
                          for (std::size_t i = 0; i < _rank.size(); ++i)
                            nts::remove(get<B>(), i, multipliers.data() + B * i,
                                        ChangedValues{view(y), view(ghosts)});
                        });
  }

  auto act(const Doubles& x, const Doubles& x_ghosts, Out<double> y,
           Out<double> y_ghosts) const
  {
    check_rows("x", x, x_ghosts);
    check_rows("y", y, y_ghosts);
    auto multipliers = create<double>({_rank.size(), components()});
    dispatch_components(
        components(),
        [&]<std::size_t B>()
        {
          nts::act(get<B>(), KnownValues{view(x), view(x_ghosts)},
                   ChangedValues{view(y), view(y_ghosts)}, view(multipliers));
        });
    return multipliers;
  }

  void add_tangent(const Doubles& x, const Doubles& x_ghosts, Out<double> y,
                   Out<double> y_ghosts) const
  {
    check_rows("x", x, x_ghosts);
    check_rows("y", y, y_ghosts);
    dispatch_components(components(),
                        [&]<std::size_t B>()
                        {
                          nts::add_tangent(
                              get<B>(), KnownValues{view(x), view(x_ghosts)},
                              ChangedValues{view(y), view(y_ghosts)});
                        });
  }

  /// @brief Largest node number plus one.
  std::size_t num_nodes() const noexcept { return _num_nodes; }

private:
  void check_values(const Doubles& values) const
  {
    if (values.size())
      check("values", values, {_rank.size(), components()});
  }

  void check_rows(const char* name, const Doubles& x,
                  const Doubles& ghosts) const
  {
    check(name, x, {any, components()});
    check("ghosts", ghosts, {any, components()});
    if (x.shape(0) + ghosts.shape(0) < _num_nodes)
      throw nb::value_error(
          (std::string(name) + ": expected a row for each of the nodes")
              .c_str());
  }

  In<std::int64_t> _start;
  In<std::int32_t> _nodes, _rank;
  Doubles _normal, _gradients, _columns, _slopes;
  In<std::int32_t> _tangent_nodes;
  Doubles _tangent;
  std::size_t _num_nodes = 0;
};
} // namespace nts::bindings

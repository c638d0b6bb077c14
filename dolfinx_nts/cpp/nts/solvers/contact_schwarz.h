#pragma once

#include "nts/solvers/elimination.h"
#include "nts/solvers/incomplete_factors.h"

#include <numeric>

/// @brief Correction in the contact subdomain, after a preconditioner of the
/// bulk without contact: an overlapping multiplicative Schwarz method with one
/// subdomain.
///
/// The subdomain has the nodes of the constraints and of the contact tangent,
/// and their neighbours in the matrix. A wide one also has the neighbours of
/// these, since a thin wall that is loaded at a node bends beyond the adjacent
/// nodes. In the subdomain a system is solved with the rows of
///
///     A = Z~^T (K + C) Z + E E^T   (see elimination.h)
///
/// for the residual of the preconditioner of the bulk. The scaled E E^T fills
/// the eliminated directions, in which right-hand sides and results vanish.
/// Rows and factors are in single precision. Rows of K are copied when a
/// contact first needs them, and are reused later.
///
/// Contact nodes are eliminated first. With friction or springs, C couples them
/// to the nodes of their segments by stiffnesses far above the bulk. Their
/// elimination then causes fill-in between these nodes and their neighbours,
/// which is in the pattern of A, so that incomplete factors keep it. In the
/// reverse order, fill-in between contact nodes on a common segment would be
/// dropped, and factors would be poor. Nodes with springs have no constraints,
/// but get the same pattern.
namespace nts
{
/// @brief Schwarz correction in the contact subdomain, see the top of this
/// file.
template <std::size_t B>
class ContactSchwarz
{
public:
  /// @param[in] K Bulk tangent, whose values must not change; columns beyond
  /// its rows belong to nodes that are not corrected.
  explicit ContactSchwarz(const BlockMatrix<B>& K)
      : _K(K), _stiffness(K.start.size() - 1), _taken(K.start.size() - 1, -1)
  {
    std::size_t columns = _stiffness.size();
    for (std::size_t i = 0; i < _stiffness.size(); ++i)
      for (std::int64_t e = K.start[i]; e < K.start[i + 1]; ++e)
      {
        const auto column = static_cast<std::size_t>(K.column[e]);
        columns = std::max(columns, column + 1);
        if (column == i)
          for (std::size_t d = 0; d < B; ++d)
            _stiffness[i] += std::abs(K[e][(B + 1) * d]) / B;
      }
    _scale = power_of_two(largest(_stiffness));
    _number.assign(columns, -1);
    _z.resize(B * columns);
  }

  /// @brief Number of columns of K, which include its rows.
  std::size_t num_columns() const noexcept { return _number.size(); }

  /// @brief Add constraints and blocks of the tangent. Their nodes are rows of
  /// K.
  void add(const Elimination<B>& e)
  {
    for (std::size_t i = 0; i < e.rank.size(); ++i)
    {
      _constraints.push_back(project(e, i));
      add_slopes(e, i);
    }
    const std::size_t k = e.width, n = B * k;
    for (std::size_t p = 0; n * n * p < e.tangent.size(); ++p)
    {
      const auto nodes = e.tangent_nodes.subspan(k * p, k);
      const double* C = e.tangent.data() + n * n * p;
      add_tangent(nodes,
                  [&](std::size_t a, std::size_t b)
                  {
                    Block<B> block;
                    for (std::size_t c = 0; c < B; ++c)
                      std::copy_n(C + n * (B * a + c) + B * b, B,
                                  block[c].begin());
                    return block;
                  });
    }
  }

  /// @brief Remove all contacts, but keep their memory.
  void clear()
  {
    for (const std::int32_t node : _nodes)
      _number[node] = -1;
    _constraints.clear();
    _tangents.clear();
    _tangent_rows.resize(0);
    _nodes.clear();
    _size = 0;
  }

  /// @brief Choose the nodes and factorise.
  /// @param[in] wide Whether the subdomain is wide. Its factors then have
  /// fill-in, ILU(1): without fill-in they are worse than factors of the narrow
  /// one.
  /// @return False if the factors do not exist.
  bool build(bool wide)
  {
    number_nodes(wide);
    for (std::size_t p = 0; p < _size; ++p)
      take_row(_nodes[p]);
    make_projected();
    return _factors.factorise(_projected, contacts_first(), wide);
  }

  /// @brief Constrain z = B r and correct it at the nodes of the subdomain.
  /// @param[in] r Returns the right-hand side of a row, which has no component
  /// in E.
  /// @param[in] z Returns a reference to the values of a column of K.
  template <class Known, class Changed>
  void correct(const Known& r, const Changed& z)
  {
    for (const Constraint& constraint : _constraints)
    {
      std::array<double, B> x = {};
      for (std::size_t a = 0; a < constraint.nodes.size(); ++a)
        add_product(constraint.right[a], z(constraint.nodes[a]), x.data());
      std::ranges::copy(x, z(constraint.nodes[0]));
    }
    if (_factors.size() != _size) // no factors exist
      return;
    double largest = 0;
    for (const std::int32_t node : _nodes)
      for (std::size_t c = 0; c < B; ++c)
        largest = std::max(largest, std::abs(z(node)[c]));
    const double scale = power_of_two(largest), back = 1 / scale;
    for (const std::int32_t node : _nodes)
      for (std::size_t c = 0; c < B; ++c)
        _z[B * node + c] = without_dust(static_cast<float>(scale * z(node)[c]));
    _x.resize(B * _size);
    const auto subtract = [&](std::size_t p, const PackedRows<B>& rows,
                              std::size_t e, std::size_t end)
    {
      const Values product = rows.product(e, end, _z.data());
      for (std::size_t c = 0; c < B; ++c)
        _x[B * p + c] -= back * static_cast<double>(product[c]);
    };
    for (std::size_t p = 0; p < _size; ++p)
    {
      for (std::size_t c = 0; c < B; ++c)
        _x[B * p + c] = _scale * r(_nodes[p])[c];
      const std::size_t e = _taken[_nodes[p]];
      subtract(p, _rows, e, e + _K.row(_nodes[p]).size());
    }
    for (const Tangent& tangent : _tangents)
      for (std::size_t a = 0, k = tangent.nodes.size(); a < k; ++a)
      {
        const std::size_t e = tangent.first + k * a;
        subtract(_number[tangent.nodes[a]], _tangent_rows, e, e + k);
      }
    for (const Constraint& constraint : _constraints)
    {
      const std::size_t s = B * _number[constraint.nodes[0]];
      std::array<double, B> eliminated;
      std::copy_n(_x.begin() + s, B, eliminated.begin());
      std::fill_n(_x.begin() + s, B, 0.0);
      for (std::size_t a = 0; a < constraint.nodes.size(); ++a)
        add_product(constraint.left[a], eliminated.data(),
                    _x.data() + B * _number[constraint.nodes[a]]);
    }
    _factors.apply(_x, _x);
    for (std::size_t p = 0; p < _size; ++p)
      for (std::size_t c = 0; c < B; ++c)
        z(_nodes[p])[c] += _x[B * p + c];
  }

  /// @brief Number of nodes of the subdomain.
  std::size_t size() const noexcept { return _size; }

private:
  /// @brief Projections by the constraints of a contact node, the identity if
  /// it has none.
  struct Constraint
  {
    std::size_t rank;                    // number of constraints
    std::vector<std::int32_t> nodes;     // nodes in them, its own node first
    std::vector<Columns<B>> right, left; // Z_0a and (Z~^T)_a0
    Columns<B> eliminated;               // E E^T at the node
  };

  /// @brief A block of the contact tangent.
  struct Tangent
  {
    std::vector<std::int32_t> nodes;
    std::size_t first; // its first row in the rows of all blocks
  };

  /// @brief Add a block of the tangent.
  /// @param[in] block Returns its part of two of the nodes, by positions.
  template <class GetBlock>
  void add_tangent(std::span<const std::int32_t> nodes, const GetBlock& block)
  {
    const std::size_t k = nodes.size(), first = _tangent_rows.size();
    _tangents.push_back({{nodes.begin(), nodes.end()}, first});
    _tangent_rows.resize(first + k * k);
    for (std::size_t a = 0; a < k; ++a)
      for (std::size_t b = 0; b < k; ++b)
        _tangent_rows.put(first + k * a + b, nodes[b],
                          Columns<B>::of(block(a, b), _scale));
  }

  /// @brief Add the block of the tangent F_a S_ab G_b^T of node i.
  void add_slopes(const Elimination<B>& e, std::size_t i)
  {
    const Matrix<B, B> S = e.slope(i);
    if (S == Matrix<B, B>{})
      return;
    add_tangent(e.list(i),
                [&](std::size_t K, std::size_t L)
                {
                  Block<B> block = {};
                  for (std::size_t a = 0; a < B; ++a)
                    for (std::size_t b = 0; b < B; ++b)
                    {
                      if (S[a][b] == 0)
                        continue;
                      const double* F = e.row(e.columns, i, a) + B * K;
                      const double* G = e.row(e.gradients, i, b) + B * L;
                      for (std::size_t c = 0; c < B; ++c)
                        for (std::size_t d = 0; d < B; ++d)
                          block[c][d] += S[a][b] * F[c] * G[d];
                    }
                  return block;
                });
  }

  /// @brief Items whose node lists contain each node of the subdomain, and its
  /// positions in these lists.
  template <class Item>
  std::vector<std::vector<std::pair<const Item*, std::size_t>>>
  by_node(const std::vector<Item>& items) const
  {
    std::vector<std::vector<std::pair<const Item*, std::size_t>>> found(_size);
    for (const Item& item : items)
      for (std::size_t a = 0; a < item.nodes.size(); ++a)
        found[_number[item.nodes[a]]].push_back({&item, a});
    return found;
  }

  /// @brief Projections by the constraints of node i.
  static Constraint project(const Elimination<B>& e, std::size_t i)
  {
    const auto list = e.list(i);
    const auto constraints = static_cast<std::size_t>(e.rank[i]);
    Constraint result{.rank = constraints};
    result.nodes.assign(list.begin(), list.end());
    // Directions in rows, and the inverses of G^T E and E^T F.
    Block<B> E = identity<B>, GE = identity<B>, EF = identity<B>;
    if (constraints == 1)
      std::copy_n(e.normal.data() + B * i, B, E[0].begin());
    for (std::size_t a = 0; a < constraints; ++a)
      for (std::size_t b = 0; b < constraints; ++b)
      {
        GE[a][b] = inner<B>(e.row(e.gradients, i, a), E[b].data());
        EF[a][b] = inner<B>(E[a].data(), e.row(e.columns, i, b));
      }
    Block<B> GE_inverse = identity<B>, EF_inverse = identity<B>;
    solve(GE, GE_inverse);
    solve(EF, EF_inverse);
    for (std::size_t K = 0; K < list.size(); ++K)
    {
      Block<B> right = K == 0 ? identity<B> : Block<B>{}, left = right;
      for (std::size_t a = 0; a < constraints; ++a)
        for (std::size_t b = 0; b < constraints; ++b)
          for (std::size_t c = 0; c < B; ++c)
            for (std::size_t d = 0; d < B; ++d)
            {
              right[c][d] -= E[a][c] * GE_inverse[a][b]
                             * e.row(e.gradients, i, b)[B * K + d];
              left[c][d] -= e.row(e.columns, i, a)[B * K + c] * EF_inverse[a][b]
                            * E[b][d];
            }
      result.right.push_back(Columns<B>::of(right));
      result.left.push_back(Columns<B>::of(left));
    }
    Block<B> eliminated = {};
    for (std::size_t a = 0; a < constraints; ++a)
      for (std::size_t c = 0; c < B; ++c)
        for (std::size_t d = 0; d < B; ++d)
          eliminated[c][d] += E[a][c] * E[a][d];
    result.eliminated = Columns<B>::of(eliminated);
    return result;
  }

  /// @brief Number the nodes of contacts and their neighbours, in a wide
  /// subdomain also the neighbours of these, and then the outer nodes in the
  /// columns of their rows.
  void number_nodes(bool wide)
  {
    constexpr std::int32_t chosen = 0;
    const auto choose = [&](std::int32_t node)
    {
      if (_number[node] >= 0)
        return;
      _number[node] = chosen;
      _nodes.push_back(node);
    };
    const auto is_row = [&](std::int32_t node)
    { return static_cast<std::size_t>(node) + 1 < _K.start.size(); };
    const auto choose_neighbours = [&](std::int32_t node)
    {
      for (const std::int32_t column : _K.row(node))
        if (is_row(column))
          choose(column);
    };
    const auto choose_around = [&](const auto& items)
    {
      for (const auto& item : items)
        for (const std::int32_t node : item.nodes)
        {
          choose(node);
          choose_neighbours(node);
        }
    };
    choose_around(_constraints);
    choose_around(_tangents);
    for (std::size_t p = 0, end = wide ? _nodes.size() : 0; p < end; ++p)
      choose_neighbours(_nodes[p]);
    std::ranges::sort(_nodes);
    _size = _nodes.size();
    for (std::size_t p = 0; p < _size; ++p)
      for (const std::int32_t column : _K.row(_nodes[p]))
        choose(column);
    for (std::size_t p = 0; p < _nodes.size(); ++p)
      _number[_nodes[p]] = static_cast<std::int32_t>(p);
  }

  /// @brief Copy a row of K, scaled, unless this was done before.
  void take_row(std::int32_t node)
  {
    if (_taken[node] >= 0)
      return;
    std::size_t place = _rows.size();
    _taken[node] = static_cast<std::int64_t>(place);
    _rows.resize(place + _K.row(node).size());
    for (std::int64_t e = _K.start[node]; e < _K.start[node + 1]; ++e)
      _rows.put(place++, _K.column[e], _K.block(e, _scale));
  }

  /// @brief Order of elimination: contact nodes, then all others.
  std::vector<std::int32_t> contacts_first() const
  {
    std::vector<bool> is_contact(_size, false);
    for (const Constraint& constraint : _constraints)
      is_contact[_number[constraint.nodes[0]]] = true;
    std::vector<std::int32_t> order(_size);
    std::iota(order.begin(), order.end(), 0);
    std::ranges::stable_partition(order, [&](std::int32_t p)
                                  { return is_contact[p]; });
    return order;
  }

  /// @brief Compute the rows of A in the subdomain.
  void make_projected()
  {
    const auto constraints = by_node(_constraints);
    const auto tangents = by_node(_tangents);
    std::vector<const Constraint*> constrainer(_size, nullptr); // by node
    for (const Constraint& constraint : _constraints)
    {
      const Constraint*& present = constrainer[_number[constraint.nodes[0]]];
      if (!present || constraint.rank > 0) // springs may share a node
        present = &constraint;
    }

    // Blocks of a row of K or C, times Z.
    const auto add_blocks = [&](const PackedRows<B>& blocks, std::size_t e,
                                std::size_t count, BlockRows<B>& sum)
    {
      for (const std::size_t end = e + count; e < end; ++e)
      {
        const auto q = static_cast<std::size_t>(_number[blocks.node(e)]);
        if (q >= _size)
          continue;
        if (const Constraint* constraint = constrainer[q])
          for (std::size_t b = 0; b < constraint->nodes.size(); ++b)
            sum.add(_number[constraint->nodes[b]],
                    blocks.block(e) * constraint->right[b]);
        else
          sum.add(static_cast<std::int32_t>(q), blocks.block(e));
      }
    };
    const auto add_row = [&](std::size_t p, BlockRows<B>& sum)
    {
      add_blocks(_rows, _taken[_nodes[p]], _K.row(_nodes[p]).size(), sum);
      for (const auto& [tangent, a] : tangents[p])
      {
        const std::size_t k = tangent->nodes.size();
        add_blocks(_tangent_rows, tangent->first + k * a, k, sum);
      }
    };
    // Z~^T adds multiples of the row of a constrained node to the rows of all
    // other nodes in its constraint.
    _constrained.clear(_size);
    std::vector<std::size_t> place(_size, 0); // row of each constrained node
    for (std::size_t p = 0; p < _size; ++p)
      if (constrainer[p])
      {
        place[p] = _constrained.size();
        add_row(p, _constrained);
        _constrained.end_row();
      }
    _projected.clear(_size);
    for (std::size_t p = 0; p < _size; ++p)
    {
      if (!constrainer[p])
        add_row(p, _projected);
      for (const auto& [constraint, a] : constraints[p])
      {
        const std::size_t node = _number[constraint->nodes[0]];
        if (constrainer[node] != constraint)
          continue;
        const std::size_t i = place[node];
        for (std::int64_t e = _constrained.start[i];
             e < _constrained.start[i + 1]; ++e)
          _projected.add(_constrained.column[e],
                         constraint->left[a] * _constrained.value[e]);
      }
      if (constrainer[p])
        _projected.add(
            static_cast<std::int32_t>(p),
            constrainer[p]->eliminated
                * static_cast<float>(_scale * _stiffness[_nodes[p]]));
      _projected.end_row();
    }
  }

  BlockMatrix<B> _K;
  std::vector<double> _stiffness;   // mean entry on the diagonal of each node
  double _scale;                    // scale of single-precision values
  PackedRows<B> _rows;              // rows of K used so far, scaled
  std::vector<std::int64_t> _taken; // offset of each node's rows, or -1
  std::vector<Constraint> _constraints;
  std::vector<Tangent> _tangents;
  PackedRows<B> _tangent_rows;       // rows of the tangents, scaled
  std::vector<std::int32_t> _nodes;  // subdomain, then outer nodes
  std::vector<std::int32_t> _number; // index of each node in `_nodes`, or -1
  std::size_t _size = 0;             // nodes of the subdomain
  BlockRows<B> _constrained;         // (K + C) Z at constrained nodes
  BlockRows<B> _projected;           // A
  IncompleteFactors<B> _factors;
  std::vector<float> _z; // values at all columns
  std::vector<double> _x;
};
} // namespace nts

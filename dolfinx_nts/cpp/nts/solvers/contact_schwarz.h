#pragma once

#include "nts/solvers/elimination.h"
#include "nts/solvers/incomplete_factors.h"

#include <numeric>

/// @brief Correction around the contacts, after a preconditioner of the bulk
/// that knows nothing of contact: an overlapping Schwarz method with one
/// subdomain.
///
/// The subdomain has the nodes of the constraints and of the contact tangent
/// and their neighbours in the matrix. There a system is solved with the rows
/// of
///
///     A = Z~^T (K + C) Z + E E^T   (see elimination.h)
///
/// for what the preconditioner of the bulk has left; E E^T, scaled, fills the
/// directions that are given up, in which neither right-hand sides nor results
/// have a part. Rows and factors are in single precision.
///
/// Contact nodes are eliminated first. With friction or springs, C ties them
/// to the nodes of their segments by stiffnesses far above those of the bulk,
/// and what their elimination fills then lies between these nodes and their
/// neighbours: in the pattern of A, so that incomplete factors keep it. The
/// other way round, the fill between contact nodes with a common segment is
/// dropped, and with many of them factors are of little use. Nodes on springs
/// have no constraints; they get the pattern of constraints all the same.
namespace nts
{
/// @brief See the head of this file.
template <std::size_t B>
class ContactSchwarz
{
public:
  /// @param[in] K Bulk tangent; columns beyond its rows are of nodes that
  /// are not changed.
  explicit ContactSchwarz(const BlockMatrix<B>& K) : _K(K)
  {
    std::size_t columns = K.start.size() - 1;
    for (const std::int32_t column : K.column)
      columns = std::max(columns, static_cast<std::size_t>(column) + 1);
    _number.assign(columns, -1);
  }

  /// @brief Nodes of the columns of K, at least those of its rows.
  std::size_t num_columns() const noexcept { return _number.size(); }

  /// @brief Add constraints and blocks of the tangent, all nodes rows of K.
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
      Tangent& tangent = _tangents.emplace_back();
      tangent.nodes.assign(nodes.begin(), nodes.end());
      tangent.blocks.resize(k * k);
      for (std::size_t a = 0; a < k; ++a)
        for (std::size_t b = 0; b < k; ++b)
          for (std::size_t c = 0; c < B; ++c)
            std::copy_n(C + n * (B * a + c) + B * b, B,
                        tangent.blocks[k * a + b][c].begin());
    }
  }

  /// @brief Remove all contacts; their memory is used again.
  void clear() noexcept
  {
    for (const std::int32_t node : _nodes)
      _number[node] = -1;
    _constraints.clear();
    _tangents.clear();
    _nodes.clear();
    _size = 0;
  }

  /// @brief Choose the nodes and factorise.
  /// @return False if the factors do not exist.
  bool build()
  {
    number_nodes();
    double largest = 0;
    for (std::size_t p = 0; p < _size; ++p)
      largest = std::max(largest, stiffness(p));
    _scale = power_of_two(largest);
    take_rows();
    make_projected();
    return _factors.factorise(_made.projected, contacts_first());
  }

  /// @brief Constrain z = B r and correct it at the nodes of the subdomain.
  /// @param[in] r Right-hand side without a part in E, (n, B).
  /// @param[in,out] z Values at the columns of K.
  void correct(std::span<const double> r, std::span<double> z)
  {
    for (const Constraint& constraint : _constraints)
    {
      std::array<double, B> x = {};
      for (std::size_t a = 0; a < constraint.nodes.size(); ++a)
        add_product(constraint.right[a], z.data() + B * constraint.nodes[a],
                    x.data());
      std::ranges::copy(x, z.begin() + B * constraint.nodes[0]);
    }
    if (_factors.size() != _size) // they do not exist
      return;
    double largest = 0;
    for (const std::int32_t node : _nodes)
      for (std::size_t c = 0; c < B; ++c)
        largest = std::max(largest, std::abs(z[B * node + c]));
    const double scale = power_of_two(largest);
    _z.resize(B * _nodes.size());
    for (std::size_t p = 0; p < _nodes.size(); ++p)
      for (std::size_t c = 0; c < B; ++c)
        _z[B * p + c]
            = without_dust(static_cast<float>(scale * z[B * _nodes[p] + c]));
    _x.resize(B * _size);
    std::size_t e = 0;
    for (std::size_t p = 0; p < _size; ++p)
    {
      const Column<B> product = _rows.product(
          e, static_cast<std::size_t>(_made.all.start[p + 1]), _z.data());
      for (std::size_t c = 0; c < B; ++c)
        _x[B * p + c] = _scale * r[B * _nodes[p] + c]
                        - static_cast<double>(product[c]) / scale;
    }
    for (const Constraint& constraint : _constraints)
    {
      const std::size_t s = B * _number[constraint.nodes[0]];
      std::array<double, B> given_up;
      std::copy_n(_x.begin() + s, B, given_up.begin());
      std::fill_n(_x.begin() + s, B, 0.0);
      for (std::size_t a = 0; a < constraint.nodes.size(); ++a)
        add_product(constraint.left[a], given_up.data(),
                    _x.data() + B * _number[constraint.nodes[a]]);
    }
    _factors.apply(_x, _x);
    for (std::size_t p = 0; p < _size; ++p)
      for (std::size_t c = 0; c < B; ++c)
        z[B * _nodes[p] + c] += _x[B * p + c];
  }

  /// @brief Number of nodes of the subdomain.
  std::size_t size() const noexcept { return _size; }

private:
  /// @brief Projections by the constraints of a contact node, the identity if
  /// it has none.
  struct Constraint
  {
    std::size_t rank;                    // number of constraints
    std::vector<std::int32_t> nodes;     // that they reach, its own first
    std::vector<Columns<B>> right, left; // Z_0a and (Z~^T)_a0
    Columns<B> given_up;                 // E E^T at the node
  };

  /// @brief A block of the contact tangent.
  struct Tangent
  {
    std::vector<std::int32_t> nodes;
    std::vector<Block<B>> blocks; // (nodes, nodes)
  };

  /// @brief Rows that `build` makes, in memory that is used again.
  struct Made
  {
    BlockRows<B> all;         // of K + C
    BlockRows<B> constrained; // times Z, those of constrained nodes
    BlockRows<B> projected;
  };

  /// @brief Add the block of the tangent F_a S_ab G_b^T of node i.
  void add_slopes(const Elimination<B>& e, std::size_t i)
  {
    const Matrix<B, B> S = e.slope(i);
    if (S == Matrix<B, B>{})
      return;
    const auto list = e.list(i);
    const std::size_t k = list.size();
    Tangent& tangent = _tangents.emplace_back();
    tangent.nodes.assign(list.begin(), list.end());
    tangent.blocks.resize(k * k);
    for (std::size_t a = 0; a < B; ++a)
      for (std::size_t b = 0; b < B; ++b)
      {
        if (S[a][b] == 0)
          continue;
        const double* F = e.row(e.columns, i, a);
        const double* G = e.row(e.gradients, i, b);
        for (std::size_t K = 0; K < k; ++K)
          for (std::size_t L = 0; L < k; ++L)
            for (std::size_t c = 0; c < B; ++c)
              for (std::size_t d = 0; d < B; ++d)
                tangent.blocks[k * K + L][c][d]
                    += S[a][b] * F[B * K + c] * G[B * L + d];
      }
  }

  /// @brief For each node of the subdomain, the items in whose lists it is,
  /// and its positions there.
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
    Block<B> given_up = {};
    for (std::size_t a = 0; a < constraints; ++a)
      for (std::size_t c = 0; c < B; ++c)
        for (std::size_t d = 0; d < B; ++d)
          given_up[c][d] += E[a][c] * E[a][d];
    result.given_up = Columns<B>::of(given_up);
    return result;
  }

  /// @brief Number the nodes of contacts and their neighbours among the rows of
  /// K, and then the nodes outside that their rows reach.
  void number_nodes()
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
    const auto choose_around = [&](const auto& items)
    {
      for (const auto& item : items)
        for (const std::int32_t node : item.nodes)
        {
          choose(node);
          for (const std::int32_t column : _K.row(node))
            if (is_row(column))
              choose(column);
        }
    };
    choose_around(_constraints);
    choose_around(_tangents);
    std::ranges::sort(_nodes);
    _size = _nodes.size();
    for (std::size_t p = 0; p < _size; ++p)
      for (const std::int32_t column : _K.row(_nodes[p]))
        choose(column);
    for (std::size_t p = 0; p < _nodes.size(); ++p)
      _number[_nodes[p]] = static_cast<std::int32_t>(p);
  }

  /// @brief Take the rows of K + C, with all their columns, scaled, also for
  /// products.
  void take_rows()
  {
    const auto tangents = by_node(_tangents);
    BlockRows<B>& rows = _made.all;
    rows.clear(_nodes.size());
    for (std::size_t p = 0; p < _size; ++p)
    {
      for (std::int64_t e = _K.start[_nodes[p]]; e < _K.start[_nodes[p] + 1];
           ++e)
        rows[_number[_K.column[e]]] = _K.block(e, _scale);
      for (const auto& [tangent, a] : tangents[p])
        for (std::size_t b = 0; b < tangent->nodes.size(); ++b)
          rows[_number[tangent->nodes[b]]] += Columns<B>::of(
              tangent->blocks[tangent->nodes.size() * a + b], _scale);
      rows.end_row();
    }
    _rows.resize(rows.column.size());
    for (std::size_t e = 0; e < rows.column.size(); ++e)
      _rows.put(e, rows.column[e], rows.value[e]);
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

  /// @brief Make Z~^T rows Z + E E^T in the subdomain.
  void make_projected()
  {
    auto& [rows, constrained, result] = _made;
    const auto constraints = by_node(_constraints);
    std::vector<const Constraint*> constrainer(_size, nullptr); // of each node
    for (const Constraint& constraint : _constraints)
    {
      const Constraint*& present = constrainer[_number[constraint.nodes[0]]];
      if (!present || constraint.rank > 0) // springs may share a node
        present = &constraint;
    }

    const auto add_row = [&, &rows = rows](std::size_t p, BlockRows<B>& sum)
    {
      for (std::int64_t e = rows.start[p]; e < rows.start[p + 1]; ++e)
      {
        const std::int32_t q = rows.column[e];
        if (static_cast<std::size_t>(q) >= _size)
          continue;
        if (const Constraint* constraint = constrainer[q])
          for (std::size_t b = 0; b < constraint->nodes.size(); ++b)
            sum[_number[constraint->nodes[b]]]
                += rows.value[e] * constraint->right[b];
        else
          sum[q] += rows.value[e];
      }
    };
    // Z~^T adds rows of constrained nodes to those that the constraints reach.
    constrained.clear(_size);
    std::vector<std::size_t> place(_size, 0); // in them
    for (std::size_t p = 0; p < _size; ++p)
      if (constrainer[p])
      {
        place[p] = constrained.size();
        add_row(p, constrained);
        constrained.end_row();
      }
    result.clear(_size);
    for (std::size_t p = 0; p < _size; ++p)
    {
      if (!constrainer[p])
        add_row(p, result);
      for (const auto& [constraint, a] : constraints[p])
      {
        const std::size_t node = _number[constraint->nodes[0]];
        if (constrainer[node] != constraint)
          continue;
        const std::size_t i = place[node];
        for (std::int64_t e = constrained.start[i];
             e < constrained.start[i + 1]; ++e)
          result[constrained.column[e]]
              += constraint->left[a] * constrained.value[e];
      }
      if (constrainer[p])
        result[static_cast<std::int32_t>(p)]
            += constrainer[p]->given_up
               * static_cast<float>(_scale * stiffness(p));
      result.end_row();
    }
  }

  /// @brief Mean size of the entries on the diagonal of K at a node.
  double stiffness(std::size_t p) const noexcept
  {
    double sum = 0;
    for (std::int64_t e = _K.start[_nodes[p]]; e < _K.start[_nodes[p] + 1]; ++e)
      if (_K.column[e] == _nodes[p])
        for (std::size_t d = 0; d < B; ++d)
          sum += std::abs(_K[e][(B + 1) * d]);
    return sum / B;
  }

  BlockMatrix<B> _K;
  std::vector<Constraint> _constraints;
  std::vector<Tangent> _tangents;
  std::vector<std::int32_t> _nodes;  // of the subdomain, then those outside
  std::vector<std::int32_t> _number; // of each node, -1 where there is none
  std::size_t _size = 0;             // of the subdomain
  PackedRows<B> _rows;               // of K + C, times _scale as the factors
  Made _made;
  double _scale = 1;
  IncompleteFactors<B> _factors;
  std::vector<float> _z;
  std::vector<double> _x;
};
} // namespace nts
